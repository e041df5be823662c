// The door to adam.cu.
#pragma once

#include <cuda_runtime_api.h>

#include <array>

#include "train/adam_args.h"

namespace b3dgs::cuda {

inline constexpr std::size_t kAdamGroupCount = 6;
using AdamGroups = std::array<AdamArgs, kAdamGroupCount>;

/// One step over all groups; arrays are aligned to 16 bytes. Does not wait.
void adam_step(const AdamGroups& groups, cudaStream_t stream);

}  // namespace b3dgs::cuda
