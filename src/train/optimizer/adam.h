// Adam with moments that live in plain tensors, so that row edits, checkpoints and resets treat them like parameters.
#pragma once

#include <array>
#include <cstdint>
#include <tuple>

#include "raster/torch/gaussian_tensors.h"
#include "train/optimizer/adam_args.h"

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
using AdamRates = std::array<double, std::tuple_size_v<AdamGroups>>;

/// Zero moments for these parameters.
AdamState make_adam_state(const GaussianTensors& gaussians);

/// @throws LogicError unless all tensors are contiguous floats on one device, of the parameters' shapes.
void check_adam_state(const GaussianTensors& gaussians, const AdamState& state);

/// What the next step of torch.optim.Adam with the constants above does to each group; counts the step. Gradients are
/// left out. @throws as check_adam_state()
AdamGroups begin_adam_step(const AdamRates& rates, GaussianTensors& gaussians, AdamState& state);

/// Takes that step on the CPU.
void adam_step(const AdamRates& rates, const GaussianTensors& grads, GaussianTensors& gaussians, AdamState& state);

}  // namespace b3dgs
