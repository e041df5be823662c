#include "train/ranks/draw_plan.h"

#include <algorithm>
#include <numeric>
#include <tuple>

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

std::vector<std::int64_t> DrawPlan::expected_work(const std::vector<std::int32_t>& views) const {
  std::int64_t sum = 0;
  for (const auto& [view, work] : work_) sum += work;
  const std::int64_t mean = work_.empty() ? 1 : sum / static_cast<std::int64_t>(work_.size());
  std::vector<std::int64_t> expected;
  for (const std::int32_t view : views) {
    const auto known = work_.find(view);
    expected.push_back(known != work_.end() ? known->second : mean);
  }
  return expected;
}

const std::vector<int>& DrawPlan::drawers(int iteration, const std::vector<std::int32_t>& views) {
  Step& step = steps_[iteration];
  if (step.views != views || step.drawers.empty()) step = {views, counted_drawers(expected_work(views), n_ranks_)};
  return step.drawers;
}

}  // namespace b3dgs
