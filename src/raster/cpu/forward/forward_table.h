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

struct ForwardRow {
  ForwardKernel kernel;
  void (*blend)(const BlendForwardArgs& args);
};

/// Indexed by ForwardKernel.
inline constexpr std::array<ForwardRow, kForwardKernels.size()> kForwardTable{{
    {ForwardKernel::kNaive, blend_forward_naive},
    {ForwardKernel::kDynamic, blend_forward_dynamic},
    {ForwardKernel::kGaussianWise, blend_forward_gaussian_wise},
    {ForwardKernel::kCombined, blend_forward_combined},
    {ForwardKernel::kSharedMemory, blend_forward_shared_memory},
    {ForwardKernel::kSegmented, blend_forward_segmented},
}};
static_assert(is_in_order(kForwardTable));

}  // namespace b3dgs::cpu
