// The forward schedules on CUDA, one file and one row each.
#pragma once

#include <array>

#include "raster/cuda/passes.h"
#include "raster/forward_kernel.h"

namespace b3dgs::cuda {

void launch_forward_naive(const BlendForwardCudaArgs& args, const LaunchContext& context);
void launch_forward_dynamic(const BlendForwardCudaArgs& args, const LaunchContext& context);
void launch_forward_gaussian_wise(const BlendForwardCudaArgs& args, const LaunchContext& context);
void launch_forward_combined(const BlendForwardCudaArgs& args, const LaunchContext& context);
void launch_forward_shared_memory(const BlendForwardCudaArgs& args, const LaunchContext& context);

/// Indexed by ForwardKernel. Tiles of 16 x 8 and 16 x 16 px.
inline constexpr std::array<void (*)(const BlendForwardCudaArgs&, const LaunchContext&), kForwardKernels.size()>
    kForwardTable{
        launch_forward_naive,    launch_forward_dynamic,       launch_forward_gaussian_wise,
        launch_forward_combined, launch_forward_shared_memory,
    };

}  // namespace b3dgs::cuda
