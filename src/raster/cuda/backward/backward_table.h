// The backward schedules on CUDA, one file and one row each.
#pragma once

#include <array>

#include "raster/backward_kernel.h"
#include "raster/cuda/kernel_resources.h"
#include "raster/cuda/passes.h"

namespace b3dgs::cuda {

void launch_backward_per_pixel(const BlendBackwardCudaArgs& args, const LaunchContext& context);
void launch_backward_per_splat(const BlendBackwardCudaArgs& args, const LaunchContext& context);

/// Resources of the schedule's kernel, for gradients by colour alone, as in training.
KernelResources backward_per_pixel_resources(const TileShape& tile);
KernelResources backward_per_splat_resources(const TileShape& tile);

struct BackwardRow {
  BackwardKernel kernel;
  void (*launch)(const BlendBackwardCudaArgs& args, const LaunchContext& context);
  KernelResources (*resources)(const TileShape& tile);
};

/// Indexed by BackwardKernel.
inline constexpr std::array<BackwardRow, kBackwardKernels.size()> kBackwardTable{{
    {BackwardKernel::kPerPixel, launch_backward_per_pixel, backward_per_pixel_resources},
    {BackwardKernel::kPerSplat, launch_backward_per_splat, backward_per_splat_resources},
}};
static_assert(is_in_order(kBackwardTable));

}  // namespace b3dgs::cuda
