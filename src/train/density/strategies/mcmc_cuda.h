// CUDA kernels that apply mcmc_math.h to all rows, without torch. All are asynchronous.
#pragma once

#include <cuda_runtime_api.h>

#include "train/density/strategies/mcmc_math.h"

namespace b3dgs::cuda {

void compute_draw_weights(const DrawWeightArgs& args, cudaStream_t stream);
void draw_rows(const DrawArgs& args, cudaStream_t stream);
void share_rows(const ShareArgs& args, cudaStream_t stream);
void add_mean_noise(const MeanNoiseArgs& args, cudaStream_t stream);

}  // namespace b3dgs::cuda
