// Which rank draws which view of a step, or which band of it, so that all have about the same work.
//
// Work is counted, not timed: list entries, from when a view was last drawn. Counts repeat exactly and are the same on
// all ranks, which therefore decide alike without asking each other.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <map>
#include <vector>

#include "raster/args.h"

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

/// A view of a step, or a band of it, that one rank draws.
struct DrawnPart {
  std::size_t view = 0;  // place in the step
  int rank = 0;
  TileRowSpan rows{};  // all, or a band
  bool is_band() const { return rows.begin > 0 || rows.end < TileRowSpan{}.end; }
};

/// The parts of a step, by view, those of a view from top to bottom. Without bands, each view is one part. With bands,
/// a rank has at most one part, and the ranks of a view ascend.
using StepPlan = std::vector<DrawnPart>;

StepPlan whole_views(const std::vector<int>& drawers);
/// The rank of each part.
std::vector<int> drawers_of(const StepPlan& plan);
inline bool is_banded(const StepPlan& plan) {
  return std::any_of(plan.begin(), plan.end(), [](const DrawnPart& part) { return part.is_band(); });
}

/// Cuts rows of tiles into bands so that the busiest has as little work as possible, and the others, within that, about
/// equal parts; equal numbers of rows if there is no work. Bands may be empty. The last one has no end, so that all
/// rows are drawn, however many there are.
std::vector<TileRowSpan> cut_rows(const std::vector<std::int64_t>& work, int n_bands);

/// For more ranks than views: each view gets a rank, and the others go one by one to the view with the most work for
/// each of its ranks. The bands of a view are those of cut_rows().
/// @param work  of each row of tiles of each view
StepPlan counted_bands(const std::vector<std::vector<std::int64_t>>& work, int n_ranks);

/// How many views of a step the ranks take at a time, so that none draws more than about `most_splats` splats of whole
/// views or bands: a multiple of the number of ranks, or, if views can be cut, a divisor of it.
/// @param splats  that a view has, on all ranks together
std::size_t views_at_a_time(double splats, int most_splats, int n_ranks, bool may_cut);

/// Decides for each step, and remembers it until the step has been taken, so that photographs can be read ahead.
class DrawPlan {
 public:
  explicit DrawPlan(int n_ranks) : n_ranks_(n_ranks) {}

  struct PlannedView {
    std::int32_t index = 0;   // in Scene::train
    std::int32_t n_rows = 0;  // of tiles
    friend bool operator==(const PlannedView& a, const PlannedView& b) {
      return a.index == b.index && a.n_rows == b.n_rows;
    }
  };

  /// Who draws `views`, which are those of the step after `iteration`; with fewer views than ranks and `may_cut`, in
  /// bands. A step keeps its answer until it is forgotten, whatever is counted meanwhile.
  const StepPlan& plan(int iteration, const std::vector<PlannedView>& views, bool may_cut);

  /// Forgets the steps before that after `iteration`.
  void forget_before(int iteration) { steps_.erase(steps_.begin(), steps_.lower_bound(iteration)); }

  /// Work of a view that has been drawn; of its rows of tiles, if that is known.
  void set_work(std::int32_t view, std::int64_t work) { work_[view] = work; }
  void set_row_work(std::int32_t view, std::vector<std::int64_t> rows);

 private:
  struct Step {
    std::vector<PlannedView> views;
    StepPlan plan;
  };

  /// For views that have not been drawn yet, the mean of the others.
  std::int64_t expected_work(std::int32_t view) const;
  /// Of each row of tiles. The rows of a view that was drawn at another size are stretched.
  std::vector<std::int64_t> expected_rows(const PlannedView& view) const;

  int n_ranks_;
  std::map<int, Step> steps_;                               // by the iteration before
  std::map<std::int32_t, std::int64_t> work_;               // by view
  std::map<std::int32_t, std::vector<std::int64_t>> rows_;  // by view
};

}  // namespace b3dgs
