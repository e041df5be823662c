// CUDA version of the background's passes, without torch.
#pragma once

#include <cuda_runtime_api.h>

#include "train/background/background_args.h"

namespace b3dgs::cuda {

/// Asynchronous, as are the others.
void add_background(const BackgroundArgs& args, cudaStream_t stream);

void background_gradient(const BackgroundGradArgs& args, cudaStream_t stream);

/// One Adam step.
void step_background(const AdamArgs& args, cudaStream_t stream);
/// Along a mean over several views.
void step_background(const AdamArgs& args, const AdamRule& rule, cudaStream_t stream);

}  // namespace b3dgs::cuda
