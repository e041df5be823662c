// Assigns the views of a step to ranks, so that all ranks have about the same work.
//
// Work is counted, not timed, as the number of list entries when a view was last rendered. Counts are reproducible and
// the same on all ranks, which therefore decide alike without further communication.
#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <vector>

namespace b3dgs {

/// Returns how many views of a step the ranks take at a time, so that none renders more than about `most_splats`
/// splats. This is a multiple of the number of ranks.
/// @param splats  number of splats in a view, on all ranks together
std::size_t views_at_a_time(double splats, std::int64_t most_splats, int n_ranks);

/// The work of each view, and the assignment of views to ranks that follows from it.
class RenderPlan {
 public:
  explicit RenderPlan(int n_ranks) : n_ranks_(n_ranks) {}

  /// Returns the rank of each of these views (indices in Scene::train), which are rendered together. Views are assigned
  /// in the order of decreasing work, each to the rank with the least work so far. If there are several, the one with
  /// the fewest views gets it, and then the lowest one. If there are at most as many views as ranks, view v goes to
  /// rank v. Views that have not been rendered yet count as the mean of the others.
  std::vector<int> renderers(const std::vector<std::int32_t>& views) const;

  /// Sets the work of a rendered view, which must not be negative.
  void set_work(std::int32_t view, std::int64_t work) { work_[view] = work; }

 private:
  int n_ranks_;
  std::map<std::int32_t, std::int64_t> work_;  // by view
};

}  // namespace b3dgs
