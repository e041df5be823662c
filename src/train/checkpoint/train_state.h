// Everything that changes from step to step, and so the content of a checkpoint.
#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>

#include "config/view_order.h"
#include "config/view_ratios.h"
#include "raster/torch/rasterizer.h"
#include "train/appearance/appearance_model.h"
#include "train/density/row_edit.h"
#include "train/optimizer/adam.h"
#include "train/poses/camera_correction.h"

namespace b3dgs {

/// What a step changes before it changes the Gaussians.
struct StepPosition {
  int iteration = 0;        // last one done; random numbers follow from it and the seed (core/random.h)
  int step_iterations = 1;  // of the last step, see --batch
  int sh_degree = 0;        // currently optimised; shN has coefficients up to the config's degree
  ViewOrder view_order;
  double loss_average = 0;  // 0.4 x new + 0.6 x old

  /// First iteration of the last step.
  int first_of_step() const { return iteration - step_iterations + 1; }
};

struct TrainState : StepPosition {
  GaussianTensors gaussians;                   // of several processes, each has some of the rows
  std::optional<std::int64_t> n_of_all_ranks;  // Gaussians of the model, if there are several processes
  AdamState adam;
  DensityStatistics statistics;
  PoseState poses;  // with --pose_opt
  AppearanceState appearance;
  ViewRatios view_ratios;   // where memory is limited
  double elapsed_s = 0;     // of training, over all sessions
  std::string training_id;  // ModelFolder::training_id(); empty in checkpoints of early versions
  // The session ended between the last iteration's step and its density control, which is still to be done.
  bool is_density_pending = false;
  std::int64_t n_removed = 0;  // invalid Gaussians that were removed (row_edit.h)
  std::int64_t held_at = 0;    // the count is held here for lack of memory; 0 = not held
  nlohmann::ordered_json kernel_selection = nlohmann::ordered_json::object();

  /// Gaussians of the model.
  std::int64_t n_gaussians() const { return n_of_all_ranks.value_or(gaussians.size()); }
};

}  // namespace b3dgs
