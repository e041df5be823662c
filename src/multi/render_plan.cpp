#include "multi/render_plan.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <tuple>

namespace b3dgs {

std::vector<int> equal_renderers(std::size_t n_views, int n_ranks) {
  std::vector<int> renderers(n_views);
  for (std::size_t v = 0; v < n_views; ++v) renderers[v] = static_cast<int>(v % static_cast<std::size_t>(n_ranks));
  return renderers;
}

std::vector<int> counted_renderers(const std::vector<std::int64_t>& work, int n_ranks) {
  if (work.size() <= static_cast<std::size_t>(n_ranks)) return equal_renderers(work.size(), n_ranks);
  struct Load {
    std::int64_t work = 0;
    int n_views = 0;
  };
  std::vector<Load> loads(static_cast<std::size_t>(n_ranks));
  std::vector<std::size_t> order(work.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return work[a] > work[b]; });
  std::vector<int> renderers(work.size());
  for (const std::size_t v : order) {
    const auto least = std::min_element(loads.begin(), loads.end(), [](const Load& a, const Load& b) {
      return std::tie(a.work, a.n_views) < std::tie(b.work, b.n_views);
    });
    renderers[v] = static_cast<int>(least - loads.begin());
    least->work += work[v];
    ++least->n_views;
  }
  return renderers;
}

std::size_t views_at_a_time(double splats, std::int64_t most_splats, int n_ranks) {
  const double n_of_each = std::floor(static_cast<double>(most_splats) / std::max(1.0, splats));
  return static_cast<std::size_t>(std::max(1.0, n_of_each)) * static_cast<std::size_t>(n_ranks);
}

std::vector<int> RenderPlan::renderers(const std::vector<std::int32_t>& views) const {
  std::int64_t sum = 0;
  for (const auto& [view, work] : work_) sum += work;
  const std::int64_t mean = work_.empty() ? 1 : sum / static_cast<std::int64_t>(work_.size());
  std::vector<std::int64_t> work;
  for (const std::int32_t view : views) {
    const auto known = work_.find(view);
    work.push_back(known == work_.end() ? mean : known->second);
  }
  return counted_renderers(work, n_ranks_);
}

}  // namespace b3dgs
