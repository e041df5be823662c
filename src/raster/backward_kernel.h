// The table of backward blending kernels on CUDA. The CPU has one, whose pool of tiles balances it. Adding a kernel:
// one row here, and one file cuda/backward/backward_ID.cu that defines launch_backward_ID() and
// backward_ID_resources().
#pragma once

#include <array>
#include <optional>
#include <string_view>

#include "raster/kernel_table.h"

// ROW(enumerator, ID, name on the command line, one line for the help text)
#define B3DGS_BACKWARD_KERNELS(ROW)                                                                       \
  ROW(kPerPixel, per_pixel, "per-pixel", "a thread per pixel, tiles assigned statically (the reference)") \
  ROW(kPerSplat, per_splat, "per-splat", "a lane per splat, pixels stream through buckets of 32 splats (balanced)")

namespace b3dgs {

enum class BackwardKernel {
#define B3DGS_ROW(kernel, id, name, summary) kernel,
  B3DGS_BACKWARD_KERNELS(B3DGS_ROW)
#undef B3DGS_ROW
};

struct BackwardKernelName {
  BackwardKernel kernel;
  std::string_view name;     // as on the command line
  std::string_view summary;  // one line for the help text
};

/// Indexed by BackwardKernel.
inline constexpr std::array kBackwardKernels{
#define B3DGS_ROW(kernel, id, name, summary) BackwardKernelName{BackwardKernel::kernel, name, summary},
    B3DGS_BACKWARD_KERNELS(B3DGS_ROW)
#undef B3DGS_ROW
};

constexpr std::string_view backward_kernel_name(BackwardKernel kernel) {
  return kBackwardKernels[static_cast<std::size_t>(kernel)].name;
}

constexpr std::optional<BackwardKernel> find_backward_kernel(std::string_view name) {
  return find_kernel(kBackwardKernels, name);
}

/// @throws LogicError if no kernel has this name
inline BackwardKernel backward_kernel(std::string_view name) {
  return kernel_named(kBackwardKernels, name);
}

}  // namespace b3dgs
