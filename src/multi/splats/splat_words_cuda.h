// CUDA kernels that apply splat_words.h to all rows, without torch. All are asynchronous.
#pragma once

#include <cuda_runtime_api.h>

#include "multi/splats/splat_words.h"

namespace b3dgs::cuda {

void pack_splats(const PackSplatsArgs& args, cudaStream_t stream);
/// `n_splats`: of all lists.
void merge_splats(const MergeSplatsArgs& args, std::int64_t n_splats, cudaStream_t stream);

}  // namespace b3dgs::cuda
