#include "train/ranks/draw_plan.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <tuple>
#include <utility>

namespace b3dgs {

std::vector<int> equal_drawers(std::size_t n_views, int n_ranks) {
  std::vector<int> drawers(n_views);
  for (std::size_t v = 0; v < n_views; ++v) drawers[v] = static_cast<int>(v % static_cast<std::size_t>(n_ranks));
  return drawers;
}

std::vector<int> counted_drawers(const std::vector<std::int64_t>& work, int n_ranks) {
  if (work.size() <= static_cast<std::size_t>(n_ranks)) return equal_drawers(work.size(), n_ranks);
  struct Load {
    std::int64_t work = 0;
    int n_views = 0;
  };
  std::vector<Load> loads(static_cast<std::size_t>(n_ranks));
  std::vector<std::size_t> order(work.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return work[a] > work[b]; });
  std::vector<int> drawers(work.size());
  for (const std::size_t v : order) {
    const auto least = std::min_element(loads.begin(), loads.end(), [](const Load& a, const Load& b) {
      return std::tie(a.work, a.n_views) < std::tie(b.work, b.n_views);
    });
    drawers[v] = static_cast<int>(least - loads.begin());
    least->work += work[v];
    ++least->n_views;
  }
  return drawers;
}

std::vector<std::int64_t> work_of_ranks(const std::vector<int>& drawers, const std::vector<std::int64_t>& work,
                                        int n_ranks) {
  std::vector<std::int64_t> sums(static_cast<std::size_t>(n_ranks));
  for (std::size_t v = 0; v < drawers.size(); ++v) sums[static_cast<std::size_t>(drawers[v])] += work[v];
  return sums;
}

std::vector<int> drawers_of(const StepPlan& plan) {
  std::vector<int> drawers;
  for (const DrawnPart& part : plan) drawers.push_back(part.rank);
  return drawers;
}

StepPlan whole_views(const std::vector<int>& drawers) {
  StepPlan plan;
  for (std::size_t v = 0; v < drawers.size(); ++v) plan.push_back({v, drawers[v], {}});
  return plan;
}

namespace {

/// Sums of the first rows: element i is the work of rows 0 to i - 1.
using WorkBefore = std::vector<std::int64_t>;

/// The last edge that a band from row `begin` may have if its work is to be at most `limit`.
std::size_t last_edge(const WorkBefore& before, std::size_t begin, std::int64_t limit) {
  const auto over =
      std::upper_bound(before.begin() + static_cast<std::ptrdiff_t>(begin), before.end(), before[begin] + limit);
  return static_cast<std::size_t>(over - before.begin()) - 1;
}

/// The first edge from which `n_bands` bands of at most `limit` reach the last row, for each n_bands from 0 to `most`.
std::vector<std::size_t> first_edges(const WorkBefore& before, int most, std::int64_t limit) {
  std::vector<std::size_t> edges{before.size() - 1};
  for (int n_bands = 1; n_bands <= most; ++n_bands) {
    const auto first = std::lower_bound(before.begin(), before.begin() + static_cast<std::ptrdiff_t>(edges.back()),
                                        before[edges.back()] - limit);
    edges.push_back(static_cast<std::size_t>(first - before.begin()));
  }
  return edges;
}

/// The least work that the busiest of `n_bands` bands can have.
std::int64_t least_limit(const WorkBefore& before, int n_bands) {
  std::int64_t low = 0, high = before.back();
  while (low < high) {
    const std::int64_t middle = low + (high - low) / 2;
    if (first_edges(before, n_bands, middle).back() == 0) {
      high = middle;
    } else {
      low = middle + 1;
    }
  }
  return low;
}

}  // namespace

std::vector<TileRowSpan> cut_rows(const std::vector<std::int64_t>& work, int n_bands) {
  const bool is_known = std::any_of(work.begin(), work.end(), [](std::int64_t row) { return row > 0; });
  WorkBefore before{0};
  for (const std::int64_t row : work) before.push_back(before.back() + (is_known ? row : 1));
  const std::int64_t limit = least_limit(before, n_bands);
  const std::vector<std::size_t> first = first_edges(before, n_bands, limit);
  std::vector<TileRowSpan> bands;
  std::size_t row = 0;
  for (int band = 1; band < n_bands; ++band) {
    // The edge nearest to equal parts, of those that keep every band within the limit.
    const double target = static_cast<double>(before.back()) * band / n_bands;
    std::size_t edge = row;
    while (edge + 1 < before.size() && static_cast<double>(before[edge] + before[edge + 1]) <= 2 * target) ++edge;
    edge = std::min(std::max(edge, first[static_cast<std::size_t>(n_bands - band)]), last_edge(before, row, limit));
    bands.push_back({static_cast<std::int32_t>(row), static_cast<std::int32_t>(edge)});
    row = edge;
  }
  bands.push_back({static_cast<std::int32_t>(row), TileRowSpan{}.end});
  return bands;
}

StepPlan counted_bands(const std::vector<std::vector<std::int64_t>>& work, int n_ranks) {
  std::vector<double> of_view;
  for (const std::vector<std::int64_t>& rows : work) {
    of_view.push_back(static_cast<double>(std::accumulate(rows.begin(), rows.end(), std::int64_t{0})));
  }
  std::vector<int> n_bands(work.size(), 1);
  for (int rank = static_cast<int>(work.size()); rank < n_ranks; ++rank) {
    std::size_t most = 0;
    for (std::size_t v = 1; v < work.size(); ++v) {
      if (of_view[v] / n_bands[v] > of_view[most] / n_bands[most]) most = v;
    }
    ++n_bands[most];
  }
  StepPlan plan;
  int rank = 0;
  for (std::size_t v = 0; v < work.size(); ++v) {
    for (const TileRowSpan& rows : cut_rows(work[v], n_bands[v])) {
      if (rows.begin < rows.end) plan.push_back({v, rank, rows});
      ++rank;
    }
  }
  return plan;
}

std::size_t views_at_a_time(double splats, int most_splats, int n_ranks, bool may_cut) {
  const double n_views = static_cast<double>(most_splats) * n_ranks / std::max(1.0, splats);
  if (n_views >= n_ranks || !may_cut)
    return static_cast<std::size_t>(std::max(1.0, std::floor(n_views / n_ranks))) * static_cast<std::size_t>(n_ranks);
  int n_cut = std::max(1, static_cast<int>(n_views));
  while (n_ranks % n_cut != 0) --n_cut;  // as many bands of each
  return static_cast<std::size_t>(n_cut);
}

std::int64_t DrawPlan::expected_work(std::int32_t view) const {
  if (const auto known = work_.find(view); known != work_.end()) return known->second;
  std::int64_t sum = 0;
  for (const auto& [other, work] : work_) sum += work;
  return work_.empty() ? 1 : sum / static_cast<std::int64_t>(work_.size());
}

std::vector<std::int64_t> DrawPlan::expected_rows(const PlannedView& view) const {
  const auto n_rows = static_cast<std::size_t>(view.n_rows);
  const auto known = rows_.find(view.index);
  if (known == rows_.end() || known->second.empty()) {
    return std::vector<std::int64_t>(n_rows,
                                     std::max<std::int64_t>(1, expected_work(view.index) / std::max(1, view.n_rows)));
  }
  std::vector<std::int64_t> rows;
  for (std::size_t row = 0; row < n_rows; ++row) rows.push_back(known->second[row * known->second.size() / n_rows]);
  return rows;
}

void DrawPlan::set_row_work(std::int32_t view, std::vector<std::int64_t> rows) {
  work_[view] = std::accumulate(rows.begin(), rows.end(), std::int64_t{0});
  rows_[view] = std::move(rows);
}

const StepPlan& DrawPlan::plan(int iteration, const std::vector<PlannedView>& views, bool may_cut) {
  Step& step = steps_[iteration];
  if (step.views == views && !step.plan.empty()) return step.plan;
  step.views = views;
  if (views.size() < static_cast<std::size_t>(n_ranks_) && may_cut) {
    std::vector<std::vector<std::int64_t>> rows;
    for (const PlannedView& view : views) rows.push_back(expected_rows(view));
    step.plan = counted_bands(rows, n_ranks_);
  } else {
    std::vector<std::int64_t> work;
    for (const PlannedView& view : views) work.push_back(expected_work(view.index));
    step.plan = whole_views(counted_drawers(work, n_ranks_));
  }
  return step.plan;
}

}  // namespace b3dgs
