// Everything that changes from step to step: what a checkpoint has to hold for a run to continue as if never stopped.
#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>
#include <string>

#include "raster/torch/gaussian_tensors.h"
#include "train/config/view_order.h"
#include "train/density/density_statistics.h"
#include "train/optimizer/adam.h"

namespace b3dgs {

struct TrainState {
  int iteration = 0;  // last one done; random numbers follow from it and the seed (random.h)
  int sh_degree = 0;  // in use; shN has room for the config's
  GaussianTensors gaussians;
  AdamState adam;
  DensityStatistics statistics;
  ViewOrder view_order;
  double loss_average = 0;  // 0.4 x new + 0.6 x old
  double elapsed_s = 0;     // of training, over all runs so far
  std::string training_id;  // see training_id.h; empty in checkpoints of early versions
  // Density control of the last iteration is still to come: the training ended between its step and that.
  bool is_density_pending = false;
  std::int64_t n_removed = 0;  // Gaussians that could not be rendered (bad_gaussians.h)
  std::int64_t held_at = 0;    // Gaussians beyond which memory does not let the model grow; 0: not held
  nlohmann::ordered_json kernel_selection = nlohmann::ordered_json::object();
};

}  // namespace b3dgs
