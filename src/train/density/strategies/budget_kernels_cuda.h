// CUDA kernels that apply budget_kernels.h to all rows, without torch. All are asynchronous.
#pragma once

#include <cuda_runtime_api.h>

#include "train/density/strategies/budget_kernels.h"

namespace b3dgs::cuda {

void draw_parent_keys(const ParentKeyArgs& args, cudaStream_t stream);
void make_parts(const PartArgs& args, cudaStream_t stream);

}  // namespace b3dgs::cuda
