// The "Ranks" section of a report: how evenly several processes share the work, and what they exchange and wait for.
#include <algorithm>

#include "core/print.h"
#include "report/report_sections.h"

namespace b3dgs {
namespace {

using RankField = std::vector<double> RankPoint::*;

/// Lines of the log with as many ranks as the last one: a training may be resumed on another number.
std::vector<const LogPoint*> points_with_ranks(const TrainHistory& history) {
  std::vector<const LogPoint*> points;
  for (const LogPoint& point : history.points) {
    if (point.ranks) points.push_back(&point);
  }
  if (points.empty()) return points;
  const std::size_t size = points.back()->ranks->entries.size();
  points.erase(std::remove_if(points.begin(), points.end(),
                              [&](const LogPoint* point) { return point->ranks->entries.size() != size; }),
               points.end());
  return points;
}

/// Mean over the steps by rank; empty if no line has it.
std::vector<double> mean_by_rank(const std::vector<const LogPoint*>& points, RankField field) {
  std::vector<double> sums;
  double n_steps = 0;
  for (const LogPoint* point : points) {
    const std::vector<double>& values = (*point->ranks).*field;
    if (values.empty()) continue;
    sums.resize(values.size());
    for (std::size_t r = 0; r < values.size(); ++r) sums[r] += values[r] * point->ranks->n_steps;
    n_steps += point->ranks->n_steps;
  }
  for (double& sum : sums) sum /= n_steps;
  return sums;
}

ChartSeries busiest_curve(const std::vector<const LogPoint*>& points, const std::string& name,
                          std::optional<double> RankPoint::*field, int color) {
  ChartSeries curve{name, {}, color};
  for (const LogPoint* point : points) {
    if (const std::optional<double> value = (*point->ranks).*field) {
      curve.points.push_back({static_cast<double>(point->iteration), *value});
    }
  }
  return curve;
}

std::string rank_table(const std::vector<const LogPoint*>& points) {
  struct Column {
    const char* head;
    const char* format;
    double unit;
    std::vector<double> values;
  };
  std::vector<double> share = mean_by_rank(points, &RankPoint::entries);
  double mean = 0;
  for (const double entries : share) mean += entries / static_cast<double>(share.size());
  for (double& entries : share) entries = mean > 0 ? entries / mean : 1;
  const Column columns[]{{"work, x the mean", "%.3f", 1, share},
                         {"sent, MB", "%.2f", 1e-6, mean_by_rank(points, &RankPoint::sent_bytes)},
                         {"received, MB", "%.2f", 1e-6, mean_by_rank(points, &RankPoint::received_bytes)},
                         {"exchange, ms", "%.3f", 1, mean_by_rank(points, &RankPoint::exchange_ms)},
                         {"of it waiting, ms", "%.3f", 1, mean_by_rank(points, &RankPoint::wait_ms)}};
  html::Row head{"rank"};
  std::vector<html::Row> rows(share.size());
  for (std::size_t r = 0; r < rows.size(); ++r) rows[r] = {std::to_string(r)};
  for (const Column& column : columns) {
    head.emplace_back(column.head);
    for (std::size_t r = 0; r < rows.size(); ++r) {
      rows[r].push_back(column.values.empty() ? "" : print_to_string(column.format, column.unit * column.values[r]));
    }
  }
  return html::table(head, rows);
}

}  // namespace

std::string rank_section(const TrainHistory& history) {
  const std::vector<const LogPoint*> points = points_with_ranks(history);
  if (points.empty()) return "";
  return html::paragraph(
             "Means per step. Work is counted: entries of tile lists, up to the last one that each pixel blends, of "
             "the "
             "views that a rank draws. Exchange is the time from when a rank is ready to exchange until it has what "
             "others sent; what is more than on the quickest rank is waiting.") +
         rank_table(points) +
         curve_figure({"Work of the busiest rank", "x the mean of all ranks",
                       "How much more than the mean the busiest rank of a step draws: by counted work, as it was done, "
                       "and in equal parts, that is with views dealt in turn or cut into bands of equally many rows."},
                      {busiest_curve(points, "counted", &RankPoint::busiest, 0),
                       busiest_curve(points, "equal parts", &RankPoint::busiest_equal, 1)});
}

}  // namespace b3dgs
