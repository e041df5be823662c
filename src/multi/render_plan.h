// Which rank renders which view of a step, so that all have about the same work.
//
// Work is counted, not timed: list entries, from when a view was last rendered. Counts repeat exactly and are the same
// on all ranks, which therefore decide alike without asking each other.
#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <vector>

namespace b3dgs {

/// How many views of a step the ranks take at a time, so that none renders more than about `most_splats` splats: a
/// multiple of the number of ranks.
/// @param splats  that a view has, on all ranks together
std::size_t views_at_a_time(double splats, std::int64_t most_splats, int n_ranks);

/// What was counted, and who renders which view by it.
class RenderPlan {
 public:
  explicit RenderPlan(int n_ranks) : n_ranks_(n_ranks) {}

  /// The rank of each of these views, by their index in Scene::train, if they are rendered together: the view with the
  /// most work first, each to the rank with the least work so far; of several, to that with the fewest views, then to
  /// the lowest. With at most as many views as ranks, the v-th view goes to rank v. Views that have not been rendered
  /// yet count as the mean of the others.
  std::vector<int> renderers(const std::vector<std::int32_t>& views) const;

  /// Work of a view that has been rendered; not negative.
  void set_work(std::int32_t view, std::int64_t work) { work_[view] = work; }

 private:
  int n_ranks_;
  std::map<std::int32_t, std::int64_t> work_;  // by view
};

}  // namespace b3dgs
