// The forward schedules on CUDA, one file and one row each.
#pragma once

#include <array>

#include "raster/cuda/kernel_resources.h"
#include "raster/cuda/passes.h"
#include "raster/forward_kernel.h"

namespace b3dgs::cuda {

void launch_forward_naive(const BlendForwardCudaArgs& args, const LaunchContext& context);
void launch_forward_dynamic(const BlendForwardCudaArgs& args, const LaunchContext& context);
void launch_forward_gaussian_wise(const BlendForwardCudaArgs& args, const LaunchContext& context);
void launch_forward_combined(const BlendForwardCudaArgs& args, const LaunchContext& context);
void launch_forward_shared_memory(const BlendForwardCudaArgs& args, const LaunchContext& context);
void launch_forward_segmented(const BlendForwardCudaArgs& args, const LaunchContext& context);

/// Resources of the schedule's kernel; of the longest-running one if it launches several.
KernelResources forward_naive_resources(const TileShape& tile);
KernelResources forward_dynamic_resources(const TileShape& tile);
KernelResources forward_gaussian_wise_resources(const TileShape& tile);
KernelResources forward_combined_resources(const TileShape& tile);
KernelResources forward_shared_memory_resources(const TileShape& tile);
KernelResources forward_segmented_resources(const TileShape& tile);

struct ForwardRow {
  ForwardKernel kernel;
  void (*launch)(const BlendForwardCudaArgs& args, const LaunchContext& context);
  KernelResources (*resources)(const TileShape& tile);
};

/// Indexed by ForwardKernel. Tiles of 16 x 8 and 16 x 16 px.
inline constexpr std::array<ForwardRow, kForwardKernels.size()> kForwardTable{{
    {ForwardKernel::kNaive, launch_forward_naive, forward_naive_resources},
    {ForwardKernel::kDynamic, launch_forward_dynamic, forward_dynamic_resources},
    {ForwardKernel::kGaussianWise, launch_forward_gaussian_wise, forward_gaussian_wise_resources},
    {ForwardKernel::kCombined, launch_forward_combined, forward_combined_resources},
    {ForwardKernel::kSharedMemory, launch_forward_shared_memory, forward_shared_memory_resources},
    {ForwardKernel::kSegmented, launch_forward_segmented, forward_segmented_resources},
}};
static_assert(is_in_order(kForwardTable));

}  // namespace b3dgs::cuda
