// Draws stacked bars and rows of histograms.
#include <algorithm>
#include <numeric>

#include "report/svg/svg_chart.h"
#include "report/svg/svg_text.h"

namespace b3dgs {
namespace {

constexpr int kWidth = 760;  // px

double sum(const std::vector<double>& values) {
  return std::accumulate(values.begin(), values.end(), 0.0);
}

std::string percent(double share) {
  return format_figure(100 * share) + " %";
}

std::string draw_stack(const StackedBars& chart, const StackedBars::Row& row, double left, double y,
                       double px_per_unit) {
  constexpr double kBar = 26;
  std::string body = svg::text(left - 10, y + 17, "class=\"label\" text-anchor=\"end\"", row.name);
  double at = left;
  for (std::size_t i = 0; i < row.parts.size(); ++i) {
    const double width = row.parts[i] * px_per_unit;
    if (width <= 0) continue;
    const std::string value = format_figure(row.parts[i]);
    body += svg::rect(at, y, std::max(0.5, width - 1), kBar, svg::color_class("f", static_cast<int>(i)),
                      row.name + ", " + chart.part_names[i] + ": " + value + " " + chart.unit);
    if (width > svg::text_width(value) + 8) {
      body += svg::text(at + width / 2, y + 17, "class=\"inside\" text-anchor=\"middle\"", value);
    }
    at += width;
  }
  return body + svg::text(at + 6, y + 17, "class=\"label\"", format_figure(sum(row.parts)) + " " + chart.unit);
}

std::string draw_panel(const HistogramRow& chart, std::size_t index, double x, double width, double top, double bottom,
                       std::size_t n_bins, double highest) {
  const HistogramRow::Panel& panel = chart.panels[index];
  const double total = sum(panel.counts), step = width / static_cast<double>(n_bins);
  std::string body = svg::text(x, top - 8, "class=\"label\"", panel.name);
  for (std::size_t bin = 0; bin < std::min(n_bins, panel.counts.size()); ++bin) {
    const double share = total > 0 ? panel.counts[bin] / total : 0;
    if (share <= 0) continue;
    const double height = std::max(1.0, share / highest * (bottom - top));
    const std::string from = bin == 0 ? "0" : format_figure(static_cast<double>(1LL << (bin - 1)));
    const std::string range = bin < 2 ? from : from + " to " + format_figure(static_cast<double>((1LL << bin) - 1));
    body += svg::rect(x + static_cast<double>(bin) * step, bottom - height, std::max(1.0, step - 1), height,
                      svg::color_class("f", 0), range + ": " + percent(share));
  }
  body += svg::line(x, bottom, x + width, bottom, "class=\"base\"");
  for (std::size_t bin = 1; bin < n_bins; bin += std::max<std::size_t>(1, (n_bins + 4) / 5)) {
    const std::string value = format_figure(static_cast<double>(1LL << (bin - 1)));
    const double at = x + static_cast<double>(bin) * step;
    if (at + svg::text_width(value) < x + width + 8) body += svg::text(at, bottom + 16, "class=\"tick\"", value);
  }
  return body;
}

}  // namespace

std::string draw(const StackedBars& chart) {
  double longest = 0, name_width = 0;
  for (const StackedBars::Row& row : chart.rows) {
    longest = std::max(longest, sum(row.parts));
    name_width = std::max(name_width, svg::text_width(row.name));
  }
  std::vector<svg::LegendEntry> entries;
  for (std::size_t i = 0; i < chart.part_names.size(); ++i)
    entries.push_back({chart.part_names[i], static_cast<int>(i)});
  double y = 4;
  std::string body = svg::legend(entries, 0, kWidth, y);
  const double left = std::min(name_width, 220.0) + 14, right = kWidth - 90;
  y += 6;
  for (const StackedBars::Row& row : chart.rows) {
    body += draw_stack(chart, row, left, y, longest > 0 ? (right - left) / longest : 0);
    y += 36;
  }
  return svg::picture(kWidth, static_cast<int>(y), chart.title, "", body);
}

std::string draw(const HistogramRow& chart) {
  constexpr double kTop = 30, kBottom = 150, kGap = 22;
  constexpr std::size_t kMaxBins = 40;  // values above 2^39 do not occur
  std::size_t n_bins = 1;
  double highest = 1e-9;
  for (const HistogramRow::Panel& panel : chart.panels) {
    const double total = sum(panel.counts);
    for (std::size_t bin = 0; bin < std::min(kMaxBins, panel.counts.size()); ++bin) {
      if (panel.counts[bin] <= 0) continue;
      n_bins = std::max(n_bins, bin + 1);
      highest = std::max(highest, panel.counts[bin] / total);
    }
  }
  const double n = static_cast<double>(std::max<std::size_t>(1, chart.panels.size()));
  const double width = (kWidth - kGap * (n - 1)) / n;
  std::string body;
  for (std::size_t i = 0; i < chart.panels.size(); ++i) {
    body += draw_panel(chart, i, static_cast<double>(i) * (width + kGap), width, kTop, kBottom, n_bins, highest);
  }
  body += svg::text(kWidth, kBottom + 34, "class=\"axis\" text-anchor=\"end\"",
                    chart.x_label + "; highest bar " + percent(highest));
  return svg::picture(kWidth, static_cast<int>(kBottom + 40), chart.title, "", body);
}

}  // namespace b3dgs
