// The forward schedules of the CPU, one file and one row each. On a CPU a thread stands for a multiprocessor, a SIMD
// vector for a warp.
#pragma once

#include <array>

#include "raster/args.h"
#include "raster/forward_kernel.h"

namespace b3dgs::cpu {

void blend_forward_naive(const BlendForwardArgs& args);
void blend_forward_dynamic(const BlendForwardArgs& args);
void blend_forward_gaussian_wise(const BlendForwardArgs& args);
void blend_forward_combined(const BlendForwardArgs& args);
void blend_forward_shared_memory(const BlendForwardArgs& args);
void blend_forward_segmented(const BlendForwardArgs& args);

/// Indexed by ForwardKernel.
inline constexpr std::array<void (*)(const BlendForwardArgs&), kForwardKernels.size()> kForwardTable{
    blend_forward_naive,    blend_forward_dynamic,       blend_forward_gaussian_wise,
    blend_forward_combined, blend_forward_shared_memory, blend_forward_segmented,
};

}  // namespace b3dgs::cpu
