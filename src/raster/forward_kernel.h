// Names of the forward blending kernels. Plain C++: command line, selector and their tests need no CUDA.
#pragma once

#include <array>
#include <optional>
#include <string_view>

#include "raster/kernel_table.h"

namespace b3dgs {

/// Every schedule computes the same image; README.md of this folder says what sets each apart, on CPU and on CUDA.
enum class ForwardKernel { kNaive, kDynamic, kGaussianWise, kCombined, kSharedMemory, kSegmented };

struct ForwardKernelName {
  ForwardKernel kernel;
  std::string_view name;     // as on the command line
  bool is_balanced;          // evens out the load between blocks, lanes or both: what the paper is about
  std::string_view summary;  // one line for the help text
};

inline constexpr std::array<ForwardKernelName, 6> kForwardKernels{{
    {ForwardKernel::kNaive, "naive", false, "lanes over pixels, tiles divided beforehand (the paper's baseline)"},
    {ForwardKernel::kDynamic, "dynamic", true, "as naive, tiles taken from an atomic pool (inter-block balancing)"},
    {ForwardKernel::kGaussianWise, "gaussian-wise", true,
     "lanes over Gaussians with prefix products, tiles divided beforehand"},
    {ForwardKernel::kCombined, "combined", true,
     "lanes over Gaussians on 4-pixel tasks from the pool (the paper's balanced kernel)"},
    {ForwardKernel::kSharedMemory, "shared-memory", false, "lanes over pixels, splats staged in fast memory"},
    {ForwardKernel::kSegmented, "segmented", true,
     "as shared-memory, long lists in segments that are joined at the end"},
}};
static_assert(is_in_order(kForwardKernels));

constexpr std::string_view forward_kernel_name(ForwardKernel kernel) {
  return kForwardKernels[static_cast<std::size_t>(kernel)].name;
}

constexpr std::optional<ForwardKernel> find_forward_kernel(std::string_view name) {
  for (const ForwardKernelName& row : kForwardKernels) {
    if (row.name == name) return row.kernel;
  }
  return std::nullopt;
}

/// False for a name that no kernel has.
constexpr bool is_balanced_kernel(std::string_view name) {
  const std::optional<ForwardKernel> kernel = find_forward_kernel(name);
  return kernel && kForwardKernels[static_cast<std::size_t>(*kernel)].is_balanced;
}

}  // namespace b3dgs
