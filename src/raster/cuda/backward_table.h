// The backward schedules on CUDA, one file and one row each.
#pragma once

#include <array>

#include "raster/backward_kernel.h"
#include "raster/cuda/passes.h"

namespace b3dgs::cuda {

void launch_backward_per_pixel(const BlendBackwardCudaArgs& args, const LaunchContext& context);
void launch_backward_per_splat(const BlendBackwardCudaArgs& args, const LaunchContext& context);

/// Indexed by BackwardKernel.
inline constexpr std::array<void (*)(const BlendBackwardCudaArgs&, const LaunchContext&), kBackwardKernels.size()>
    kBackwardTable{launch_backward_per_pixel, launch_backward_per_splat};

}  // namespace b3dgs::cuda
