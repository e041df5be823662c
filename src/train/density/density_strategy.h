// The interface of density control: which Gaussians are added and removed while a model is trained.
//
// In each iteration, take_step() calls plan(), after_view() after the backward pass and after_step() after the
// optimizer. After the outputs, DensityControl calls plan_round(), end_round() once the edit is applied, and
// lower_opacities(). All but plan() are called only where plan() says so. DensityControl also keeps the model within
// memory, and repeats a round that ran out of memory.
//
// A strategy has no state of its own, so that a resumed training continues bit for bit. Data per Gaussian are columns
// of DensityStatistics, which row edits and checkpoints carry along. Random numbers are a function of seed, purpose,
// iteration and index.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>

#include "config/train_config.h"
#include "raster/torch/rasterizer.h"
#include "scene/crop_region.h"
#include "train/density/row_edit.h"
#include "train/optimizer/adam.h"

namespace b3dgs {

/// The work of a strategy in one iteration.
struct DensityPlan {
  bool after_step = false;  // after_step() has work to do
  bool statistics = false;  // after_view() collects statistics of the view
  bool densify = false;     // there is a round of densification and pruning
  bool lower_opacities = false;
  bool score = false;  // after_view() calls DensityView::add_scores
};

/// A view of a step after its backward pass. Tensors are valid until the next view.
struct DensityView {
  int iteration = 0;  // counted from 1
  const ViewStatistics& view;
  std::int32_t width = 0, height = 0;  // size of the view, px
  // Adds the scores of the view's Gaussians, weighted by the errors of its pixels (loss.h) (Rasterizer::score()). Empty
  // unless DensityPlan::score is set.
  std::function<void(const GaussianScores&)> add_scores{};
};

/// The plan of one round of densification and pruning.
struct DensityRound {
  RowEdit edit;
  std::int64_t n_cloned = 0, n_split = 0, n_pruned = 0;
  std::int64_t n_over_limit = 0;  // candidates that were not added because of the limit
};

/// Returns the arrays that rounds and noise read: all parameters but the colours, which several ranks do not exchange.
GaussianArrays arrays_without_colors(const GaussianTensors& gaussians);

class DensityStrategy {
 public:
  /// `extent` is the scene extent in world units.
  DensityStrategy(const TrainConfig& config, double extent) : config_(config), extent_(extent) {}
  virtual ~DensityStrategy() = default;

  /// Sets the region of --crop, in the frame of the scene.
  void set_region(const CropRegion& region) { region_ = region; }

  /// Returns zero statistics of `n_gaussians`. A strategy may add columns to the common ones.
  virtual DensityStatistics make_statistics(std::int64_t n_gaussians, torch::Device device) const;

  /// Returns the work in an iteration, counted from 1.
  virtual DensityPlan plan(int iteration) const = 0;

  /// Adds the view to the statistics. Must neither allocate nor fail, because with one view per step this is called
  /// after the step has changed the model and can no longer be rolled back.
  virtual void after_view(const DensityView& /*seen*/, DensityStatistics& /*statistics*/) const {}

  /// Changes parameters in place, for example adds noise to the means. Called for each iteration of the step, with the
  /// same restrictions. `model_rows` [N] int32 contains the index of each of `gaussians` in the whole model. It is
  /// undefined if `gaussians` is the whole model. The change to a Gaussian must not depend on which others are present.
  virtual void after_step(int /*iteration*/, GaussianTensors& /*gaussians*/,
                          const torch::Tensor& /*model_rows*/ = {}) const {}

  /// Plans a round without changing anything. After the edit, there are at most `max_gaussians` (0 = no limit). If
  /// there are more already, the edit adds none. Once the edit is applied, end_round() is called.
  virtual DensityRound plan_round(const GaussianTensors& gaussians, const DensityStatistics& statistics, int iteration,
                                  std::int64_t max_gaussians) const = 0;

  /// Called after the edit of a round. Sets the statistics to 0, or only those that the next round starts anew.
  virtual void end_round(int iteration, DensityStatistics& statistics) const;

  /// Resets the opacities in place.
  virtual void lower_opacities(GaussianTensors& /*gaussians*/, AdamState& /*adam*/) const {}

 protected:
  const TrainConfig config_;
  const double extent_;
  std::optional<CropRegion> region_;
};

/// Creates the strategy config.strategy.
std::unique_ptr<DensityStrategy> make_density_strategy(const TrainConfig& config, double extent);

}  // namespace b3dgs
