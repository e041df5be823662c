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

/// View v of a step goes to rank v % n_ranks: what is done without counts.
std::vector<int> equal_renderers(std::size_t n_views, int n_ranks);

/// The rank of each view: the view with the most work first, each to the rank with the least work so far; of several,
/// to that with the fewest views, then to the lowest. With at most as many views as ranks, as equal_renderers().
/// @param work  of each view, not negative
std::vector<int> counted_renderers(const std::vector<std::int64_t>& work, int n_ranks);

/// How many views of a step the ranks take at a time, so that none renders more than about `most_splats` splats: a
/// multiple of the number of ranks.
/// @param splats  that a view has, on all ranks together
std::size_t views_at_a_time(double splats, std::int64_t most_splats, int n_ranks);

/// Decides for each step, and remembers it until the step has been taken, so that photographs can be read ahead.
class RenderPlan {
 public:
  explicit RenderPlan(int n_ranks) : n_ranks_(n_ranks) {}

  /// The rank of each of `views`, which are those of the step after `iteration`, by their index in Scene::train. A step
  /// keeps its answer until it is forgotten, whatever is counted meanwhile.
  const std::vector<int>& renderers(int iteration, const std::vector<std::int32_t>& views);

  /// Forgets the steps before that after `iteration`.
  void forget_before(int iteration) { steps_.erase(steps_.begin(), steps_.lower_bound(iteration)); }

  /// Work of a view that has been rendered.
  void set_work(std::int32_t view, std::int64_t work) { work_[view] = work; }

 private:
  struct Step {
    std::vector<std::int32_t> views;
    std::vector<int> renderers;
  };

  /// For views that have not been rendered yet, the mean of the others.
  std::int64_t expected_work(std::int32_t view) const;

  int n_ranks_;
  std::map<int, Step> steps_;                  // by the iteration before
  std::map<std::int32_t, std::int64_t> work_;  // by view
};

}  // namespace b3dgs
