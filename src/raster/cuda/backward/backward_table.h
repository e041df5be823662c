// The backward kernels on CUDA, generated from the table in backward_kernel.h; each is defined in backward_ID.cu.
#pragma once

#include <array>

#include "raster/backward_kernel.h"
#include "raster/cuda/kernel_resources.h"
#include "raster/cuda/passes.h"

namespace b3dgs::cuda {

/// Resources are those for gradients with respect to colour alone, as in training.
#define B3DGS_ROW(kernel, id, name, summary)                                                  \
  void launch_backward_##id(const BlendBackwardCudaArgs& args, const LaunchContext& context); \
  KernelResources backward_##id##_resources(const TileShape& tile);
B3DGS_BACKWARD_KERNELS(B3DGS_ROW)
#undef B3DGS_ROW

struct BackwardRow {
  BackwardKernel kernel;
  void (*launch)(const BlendBackwardCudaArgs& args, const LaunchContext& context);
  KernelResources (*resources)(const TileShape& tile);
};

/// Indexed by BackwardKernel.
inline constexpr std::array kBackwardTable{
#define B3DGS_ROW(kernel, id, name, summary) \
  BackwardRow{BackwardKernel::kernel, launch_backward_##id, backward_##id##_resources},
    B3DGS_BACKWARD_KERNELS(B3DGS_ROW)
#undef B3DGS_ROW
};

}  // namespace b3dgs::cuda
