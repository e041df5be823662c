// CUDA version of the bilateral grid, without torch. Everything is asynchronous.
#pragma once

#include <cuda_runtime_api.h>

#include "train/appearance/bilateral_grid_args.h"

namespace b3dgs::cuda {

void apply_bilateral_grid(const BilateralGridArgs& args, cudaStream_t stream);

/// Doubles of BilateralGridArgs::cell_sums.
std::int64_t bilateral_grid_sums();

/// Sums have a fixed order.
void bilateral_grid_backward(const BilateralGridArgs& args, cudaStream_t stream);

/// `adam` is one grid.
void apply_missed_steps(const AdamArgs& adam, const MissedSteps& missed, cudaStream_t stream);

void bilateral_grid_step(const AdamArgs& adam, cudaStream_t stream);

}  // namespace b3dgs::cuda
