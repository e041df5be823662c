// Adam with its moments in plain tensors, so that row edits, checkpoints and resets handle them like parameters.
#pragma once

#include <array>
#include <cstdint>
#include <tuple>

#include "raster/torch/gaussian_tensors.h"
#include "train/optimizer/adam_args.h"

namespace b3dgs {

namespace cpu {

/// The result does not depend on the number of threads.
void adam_step(const AdamArgs& args, const AdamRule& rule = {});

}  // namespace cpu

struct AdamState {
  GaussianTensors m, v;  // first and second moments, shapes of the parameters
  // Taken so far, by all groups and rows alike (as in torch.optim.Adam); a step along n views counts n times.
  std::int64_t steps = 0;
};

/// One learning rate per parameter group, in the order of GaussianTensors.
using AdamRates = std::array<double, std::tuple_size_v<AdamGroups>>;

/// Zero moments for these parameters.
AdamState make_adam_state(const GaussianTensors& gaussians);

/// @throws LogicError unless all tensors are contiguous floats on one device, with the shapes of the parameters
void check_adam_state(const GaussianTensors& gaussians, const AdamState& state);

/// Arguments of the next step for each group, without gradients; adds n_views to state.steps. @throws as
/// check_adam_state()
AdamGroups begin_adam_step(const AdamRates& rates, GaussianTensors& gaussians, AdamState& state, int n_views = 1);

/// Takes a step on the CPU, along the gradient of a mean over n views (adam_rule()). `rates` are used as they are.
void adam_step(const AdamRates& rates, const GaussianTensors& grads, GaussianTensors& gaussians, AdamState& state,
               int n_views = 1);

}  // namespace b3dgs
