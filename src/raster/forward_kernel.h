// The table of forward blending kernels. Plain C++: the command line, the kernel selector and their tests need no CUDA.
//
// Adding a kernel: one row here, one file cpu/forward/forward_ID.cpp that defines blend_forward_ID(), and one file
// cuda/forward/forward_ID.cu that defines launch_forward_ID() and forward_ID_resources().
#pragma once

#include <array>
#include <optional>
#include <string_view>

#include "raster/kernel_table.h"

// ROW(enumerator, ID, name on the command line, is_balanced, one line for the help text)
#define B3DGS_FORWARD_KERNELS(ROW)                                                                                     \
  ROW(kNaive, naive, "naive", false, "a lane per pixel, tiles assigned statically (the paper's baseline)")             \
  ROW(kDynamic, dynamic, "dynamic", true, "as naive, with tiles taken from an atomic counter (inter-block balancing)") \
  ROW(kGaussianWise, gaussian_wise, "gaussian-wise", true,                                                             \
      "a lane per Gaussian with prefix products, tiles assigned statically")                                           \
  ROW(kCombined, combined, "combined", true,                                                                           \
      "a lane per Gaussian, tasks of 4 pixels from an atomic counter (the paper's balanced kernel)")                   \
  ROW(kSharedMemory, shared_memory, "shared-memory", false, "a lane per pixel, splats staged in shared memory")        \
  ROW(kSegmented, segmented, "segmented", true,                                                                        \
      "as shared-memory, with long lists cut into segments that are blended in parallel")

namespace b3dgs {

/// All kernels compute the same image. README.md of this folder compares their schedules on CPU and CUDA.
enum class ForwardKernel {
#define B3DGS_ROW(kernel, id, name, is_balanced, summary) kernel,
  B3DGS_FORWARD_KERNELS(B3DGS_ROW)
#undef B3DGS_ROW
};

struct ForwardKernelName {
  ForwardKernel kernel;
  std::string_view name;     // as on the command line
  bool is_balanced;          // balances the load between blocks, lanes or both: the subject of the paper
  std::string_view summary;  // one line for the help text
};

/// Indexed by ForwardKernel.
inline constexpr std::array kForwardKernels{
#define B3DGS_ROW(kernel, id, name, is_balanced, summary) \
  ForwardKernelName{ForwardKernel::kernel, name, is_balanced, summary},
    B3DGS_FORWARD_KERNELS(B3DGS_ROW)
#undef B3DGS_ROW
};

constexpr std::string_view forward_kernel_name(ForwardKernel kernel) {
  return kForwardKernels[static_cast<std::size_t>(kernel)].name;
}

constexpr std::optional<ForwardKernel> find_forward_kernel(std::string_view name) {
  return find_kernel(kForwardKernels, name);
}

/// @throws LogicError if no kernel has this name
inline ForwardKernel forward_kernel(std::string_view name) {
  return kernel_named(kForwardKernels, name);
}

/// False for a name that no kernel has.
constexpr bool is_balanced_kernel(std::string_view name) {
  const std::optional<ForwardKernel> kernel = find_forward_kernel(name);
  return kernel && kForwardKernels[static_cast<std::size_t>(*kernel)].is_balanced;
}

}  // namespace b3dgs
