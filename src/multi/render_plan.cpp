#include "multi/render_plan.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

namespace b3dgs {

std::size_t views_at_a_time(double splats, std::int64_t most_splats, int n_ranks) {
  const double n_of_each = std::floor(static_cast<double>(most_splats) / std::max(1.0, splats));
  return static_cast<std::size_t>(std::max(1.0, n_of_each)) * static_cast<std::size_t>(n_ranks);
}

std::vector<int> RenderPlan::renderers(const std::vector<std::int32_t>& views) const {
  std::vector<int> renderers(views.size());
  std::iota(renderers.begin(), renderers.end(), 0);
  if (views.size() <= static_cast<std::size_t>(n_ranks_)) return renderers;
  std::int64_t sum = 0;
  for (const auto& [view, work] : work_) sum += work;
  const std::int64_t mean = work_.empty() ? 1 : sum / static_cast<std::int64_t>(work_.size());
  std::vector<std::pair<std::int64_t, std::size_t>> order;  // work, view
  for (std::size_t v = 0; v < views.size(); ++v) {
    const auto known = work_.find(views[v]);
    order.emplace_back(known == work_.end() ? mean : known->second, v);
  }
  std::stable_sort(order.begin(), order.end(), [](const auto& a, const auto& b) { return a.first > b.first; });
  std::vector<std::pair<std::int64_t, int>> loads(static_cast<std::size_t>(n_ranks_));  // work, views
  for (const auto& [work, v] : order) {
    const auto least = std::min_element(loads.begin(), loads.end());
    renderers[v] = static_cast<int>(least - loads.begin());
    least->first += work;
    ++least->second;
  }
  return renderers;
}

}  // namespace b3dgs
