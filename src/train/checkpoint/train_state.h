// Everything that changes from step to step, and therefore the content of a checkpoint. Numbers such as the iteration
// are in StateValues (model/checkpoint/checkpoint_header.h).
#pragma once

#include <cstdint>
#include <optional>

#include "model/checkpoint/checkpoint_header.h"
#include "raster/torch/rasterizer.h"
#include "train/appearance/appearance_model.h"
#include "train/density/row_edit.h"
#include "train/optimizer/adam.h"
#include "train/poses/pose_refiner.h"

namespace b3dgs {

struct TrainState : StateValues {
  GaussianTensors gaussians;                   // with several processes, each has part of them
  std::optional<std::int64_t> n_of_all_ranks;  // number of Gaussians of the model, only with several processes
  AdamState adam;
  DensityStatistics statistics;
  PoseState poses;  // with --pose_opt
  AppearanceState appearance;

  /// Returns the number of Gaussians of the model.
  std::int64_t n_gaussians() const { return n_of_all_ranks.value_or(gaussians.size()); }
  /// Returns whether `gaussians` is the whole model.
  bool is_whole() const { return !n_of_all_ranks; }
};

}  // namespace b3dgs
