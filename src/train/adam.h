// Adam with moments that live in plain tensors, so that row edits, checkpoints and resets treat them like parameters.
#pragma once

#include <array>
#include <cstdint>

#include "raster/gaussian_tensors.h"
#include "train/adam_args.h"

namespace b3dgs {

namespace cpu {

/// The same bits for any number of threads.
void adam_step(const AdamArgs& args);

}  // namespace cpu

struct AdamState {
  GaussianTensors m, v;    // first and second moments, shapes of the parameters
  std::int64_t steps = 0;  // taken so far; common to all groups and rows, as in torch
};

/// One rate per parameter group, in the order of GaussianTensors.
using AdamRates = std::array<double, 6>;

/// Zero moments for these parameters.
AdamState make_adam_state(const GaussianTensors& gaussians);

/// One step of torch.optim.Adam with the constants above. All tensors are contiguous floats on one device.
/// @throws InputError if this build has no Adam for the device.
void adam_step(const AdamRates& rates, const GaussianTensors& grads, GaussianTensors& gaussians, AdamState& state);

}  // namespace b3dgs
