// Density control behind one interface: which Gaussians are added and removed while a model is trained.
//
// In each iteration the trainer asks plan() what there is to do, and then calls, in this order: after_view() after the
// backward pass, after_step() after the optimizer, plan_round() after log line, evaluation and PLY, lower_opacities().
// The strategy decides; the trainer applies the RowEdit, keeps the model within memory, and repeats a round that ran
// out of it.
//
// A strategy has no state of its own. What it remembers of a Gaussian is a column of DensityStatistics, which row edits
// and checkpoints carry along; random numbers follow from (seed, purpose, iteration, row). So a resumed training
// continues bit for bit.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>

#include "config/train_config.h"
#include "raster/torch/rasterizer.h"
#include "train/density/row_edit.h"
#include "train/optimizer/adam.h"

namespace b3dgs {

/// What a strategy does in one iteration.
struct DensityPlan {
  bool after_step = false;  // after_step() has work to do
  bool statistics = false;  // after_view() collects statistics of the view
  bool densify = false;     // a round of densification and pruning
  bool lower_opacities = false;
  bool score = false;  // after_view() needs DensityView::add_scores
};

/// A view of a step, after its backward pass. Tensors are valid until the next view.
struct DensityView {
  int iteration = 0;  // counted from 1
  const ViewStatistics& view;
  std::int32_t width = 0, height = 0;  // px, of the view
  // Adds what the view's pixels say about its Gaussians (Rasterizer::score()), given their errors (loss.h).
  // Empty unless the plan says `score`.
  std::function<void(const GaussianScores&)> add_scores{};
};

/// One round of densification and pruning.
struct DensityRound {
  RowEdit edit;
  std::int64_t n_cloned = 0, n_split = 0, n_pruned = 0;
  std::int64_t n_over_limit = 0;  // candidates that were not added because of the limit
};

/// Arrays of the parameters that rounds and noise read: all but colours, which several ranks do not exchange.
GaussianArrays arrays_without_colors(const GaussianTensors& gaussians);

class DensityStrategy {
 public:
  /// `extent`: the scene extent, world units.
  DensityStrategy(const TrainConfig& config, double extent) : config_(config), extent_(extent) {}
  virtual ~DensityStrategy() = default;

  /// Zero statistics of `n_gaussians`; with further columns if the strategy needs more than the common ones.
  virtual DensityStatistics make_statistics(std::int64_t n_gaussians, torch::Device device) const;

  virtual DensityPlan plan(int iteration) const = 0;

  /// Adds the view to the statistics. Must neither allocate nor fail: with one view a step, this comes after the first
  /// change, after which a step is not rolled back.
  virtual void after_view(const DensityView& /*seen*/, DensityStatistics& /*statistics*/) const {}

  /// May change parameters in place (noise on the means); called for each iteration of the step, with the same
  /// restrictions. `model_rows`: [N] int32, the row of the model that each of `gaussians` is; undefined if they are the
  /// model. What happens to a Gaussian must not depend on which others are there.
  virtual void after_step(int /*iteration*/, GaussianTensors& /*gaussians*/,
                          const torch::Tensor& /*model_rows*/ = {}) const {}

  /// Changes nothing. The edit leaves at most `max_gaussians` rows (0 = no limit), or adds none if there are more
  /// already. Once the edit is applied, end_round() follows.
  virtual DensityRound plan_round(const GaussianTensors& gaussians, const DensityStatistics& statistics, int iteration,
                                  std::int64_t max_gaussians) const = 0;

  /// After a round's edit: sets the statistics to 0, or those that the next round is to start anew.
  virtual void end_round(int iteration, DensityStatistics& statistics) const;

  /// In place: an opacity reset.
  virtual void lower_opacities(GaussianTensors& /*gaussians*/, AdamState& /*adam*/) const {}

 protected:
  const TrainConfig config_;
  const double extent_;
};

/// The strategy that config.strategy names. @throws LogicError if there is none
std::unique_ptr<DensityStrategy> make_density_strategy(const TrainConfig& config, double extent);

}  // namespace b3dgs
