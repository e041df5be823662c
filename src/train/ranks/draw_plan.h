// Which rank draws which view of a step, so that all have about the same work.
//
// Work is counted, not timed: list entries, from when a view was last drawn. Counts repeat exactly and are the same on
// all ranks, which therefore decide alike without asking each other.
#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <vector>

namespace b3dgs {

/// View v of a step goes to rank v % n_ranks: what is done without counts.
std::vector<int> equal_drawers(std::size_t n_views, int n_ranks);

/// The rank of each view: the view with the most work first, each to the rank with the least work so far; of several,
/// to that with the fewest views, then to the lowest. With at most as many views as ranks, as equal_drawers().
/// @param work  of each view, not negative
std::vector<int> counted_drawers(const std::vector<std::int64_t>& work, int n_ranks);

/// Work of each rank. @param drawers  rank of each view
std::vector<std::int64_t> work_of_ranks(const std::vector<int>& drawers, const std::vector<std::int64_t>& work,
                                        int n_ranks);

/// Decides for each step, and remembers it until the step has been taken, so that photographs can be read ahead.
class DrawPlan {
 public:
  explicit DrawPlan(int n_ranks) : n_ranks_(n_ranks) {}

  /// The rank of each of `views`, which are those of the step after `iteration`. A step keeps its answer until it is
  /// forgotten, whatever is counted meanwhile.
  const std::vector<int>& drawers(int iteration, const std::vector<std::int32_t>& views);

  /// Forgets the steps before that after `iteration`.
  void forget_before(int iteration) { steps_.erase(steps_.begin(), steps_.lower_bound(iteration)); }

  /// Work of a view that has been drawn.
  void set_work(std::int32_t view, std::int64_t work) { work_[view] = work; }

 private:
  struct Step {
    std::vector<std::int32_t> views;
    std::vector<int> drawers;
  };

  /// For views that have not been drawn yet, the mean of the others.
  std::vector<std::int64_t> expected_work(const std::vector<std::int32_t>& views) const;

  int n_ranks_;
  std::map<int, Step> steps_;                  // by the iteration before
  std::map<std::int32_t, std::int64_t> work_;  // by view
};

}  // namespace b3dgs
