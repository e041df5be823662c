// The tables of blending kernels, forward and backward. Plain C++: the command line, the kernel selector and their
// tests need no CUDA.
//
// Adding a forward kernel: one row here, blend_forward_ID() in a source of cpu/forward, and launch_forward_ID() in one
// of cuda/forward. A backward kernel, of which the CPU has one, whose pool of tiles balances it: one row, and
// launch_backward_ID() in a source of cuda/backward.
#pragma once

#include <array>
#include <cstddef>
#include <optional>
#include <string_view>

#include "core/check.h"

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

#define B3DGS_BACKWARD_KERNELS(ROW)                                                                              \
  ROW(kPerPixel, per_pixel, "per-pixel", false, "a thread per pixel, tiles assigned statically (the reference)") \
  ROW(kPerBucket, per_bucket, "per-bucket", true, "a block per 128 entries of a tile's list (balanced)")

namespace b3dgs {

template <class Kernel>
struct KernelRow {
  Kernel kernel;
  std::string_view name;     // as on the command line
  bool is_balanced;          // balances the load between blocks, lanes or both: the subject of the paper
  std::string_view summary;  // one line for the help text
};

/// All kernels compute the same image. README.md of this folder compares their schedules on CPU and CUDA.
enum class ForwardKernel {
#define B3DGS_ROW(kernel, id, name, is_balanced, summary) kernel,
  B3DGS_FORWARD_KERNELS(B3DGS_ROW)
#undef B3DGS_ROW
};

enum class BackwardKernel {
#define B3DGS_ROW(kernel, id, name, is_balanced, summary) kernel,
  B3DGS_BACKWARD_KERNELS(B3DGS_ROW)
#undef B3DGS_ROW
};

using ForwardKernelName = KernelRow<ForwardKernel>;
using BackwardKernelName = KernelRow<BackwardKernel>;

/// Indexed by ForwardKernel.
inline constexpr std::array kForwardKernels{
#define B3DGS_ROW(kernel, id, name, is_balanced, summary) \
  ForwardKernelName{ForwardKernel::kernel, name, is_balanced, summary},
    B3DGS_FORWARD_KERNELS(B3DGS_ROW)
#undef B3DGS_ROW
};
/// Indexed by BackwardKernel.
inline constexpr std::array kBackwardKernels{
#define B3DGS_ROW(kernel, id, name, is_balanced, summary) \
  BackwardKernelName{BackwardKernel::kernel, name, is_balanced, summary},
    B3DGS_BACKWARD_KERNELS(B3DGS_ROW)
#undef B3DGS_ROW
};

constexpr std::string_view kernel_name(ForwardKernel kernel) {
  return kForwardKernels[static_cast<std::size_t>(kernel)].name;
}
constexpr std::string_view kernel_name(BackwardKernel kernel) {
  return kBackwardKernels[static_cast<std::size_t>(kernel)].name;
}

/// The kernel with this name in one of the tables, if there is one.
template <class Rows>
constexpr auto find_kernel(const Rows& rows, std::string_view name) -> std::optional<decltype(rows[0].kernel)> {
  for (const auto& row : rows) {
    if (row.name == name) return row.kernel;
  }
  return std::nullopt;
}

/// The same. @throws LogicError if there is none: names from users are checked before
template <class Rows>
auto kernel_named(const Rows& rows, std::string_view name) {
  const auto kernel = find_kernel(rows, name);
  B3DGS_CHECK(kernel.has_value(), "unknown kernel: ", name);
  return *kernel;
}

/// Whether it is a forward kernel that is balanced; false for a name that no kernel has.
constexpr bool is_balanced_kernel(std::string_view name) {
  for (const auto& row : kForwardKernels) {
    if (row.name == name) return row.is_balanced;
  }
  return false;
}

}  // namespace b3dgs
