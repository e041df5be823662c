// Everything that changes from step to step: what a checkpoint has to hold for a run to continue as if never stopped.
#pragma once

#include <nlohmann/json.hpp>

#include "raster/gaussian_tensors.h"
#include "train/adam.h"
#include "train/density_statistics.h"
#include "train/view_order.h"

namespace b3dgs {

struct TrainState {
  int iteration = 0;  // last one done; random numbers follow from it and the seed (random.h)
  int sh_degree = 0;  // in use; shN has room for the config's
  GaussianTensors gaussians;
  AdamState adam;
  DensityStatistics statistics;
  ViewOrder view_order;
  double loss_average = 0;   // 0.4 x new + 0.6 x old
  double elapsed_s = 0;      // of training, over all runs so far
  std::int64_t held_at = 0;  // Gaussians beyond which memory does not let the model grow; 0: not held
  nlohmann::ordered_json kernel_selection = nlohmann::ordered_json::object();
};

}  // namespace b3dgs
