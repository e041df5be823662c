// The forward kernels on CUDA, generated from the table in forward_kernel.h; each is defined in forward_ID.cu. They
// support tiles of 16 x 8 and 16 x 16 px.
#pragma once

#include <array>

#include "raster/cuda/kernel_resources.h"
#include "raster/cuda/passes.h"
#include "raster/forward_kernel.h"

namespace b3dgs::cuda {

/// Resources are those of the kernel that runs longest, if a schedule launches several.
#define B3DGS_ROW(kernel, id, name, is_balanced, summary)                                   \
  void launch_forward_##id(const BlendForwardCudaArgs& args, const LaunchContext& context); \
  KernelResources forward_##id##_resources(const TileShape& tile);
B3DGS_FORWARD_KERNELS(B3DGS_ROW)
#undef B3DGS_ROW

struct ForwardRow {
  ForwardKernel kernel;
  void (*launch)(const BlendForwardCudaArgs& args, const LaunchContext& context);
  KernelResources (*resources)(const TileShape& tile);
};

/// Indexed by ForwardKernel.
inline constexpr std::array kForwardTable{
#define B3DGS_ROW(kernel, id, name, is_balanced, summary) \
  ForwardRow{ForwardKernel::kernel, launch_forward_##id, forward_##id##_resources},
    B3DGS_FORWARD_KERNELS(B3DGS_ROW)
#undef B3DGS_ROW
};

}  // namespace b3dgs::cuda
