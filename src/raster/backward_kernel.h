// Names of the backward blending kernels on CUDA. The CPU has one schedule, which is balanced by its pool of tiles.
#pragma once

#include <array>
#include <cstddef>
#include <optional>
#include <string_view>

#include "raster/kernel_table.h"

namespace b3dgs {

enum class BackwardKernel { kPerPixel, kPerSplat };

struct BackwardKernelName {
  BackwardKernel kernel;
  std::string_view name;     // as on the command line
  std::string_view summary;  // one line for the help text
};

inline constexpr std::array<BackwardKernelName, 2> kBackwardKernels{{
    {BackwardKernel::kPerPixel, "per-pixel", "a thread per pixel, static blocks (the reference)"},
    {BackwardKernel::kPerSplat, "per-splat", "a lane per splat, pixels stream through buckets of 32 (balanced)"},
}};
static_assert(is_in_order(kBackwardKernels));

constexpr std::string_view backward_kernel_name(BackwardKernel kernel) {
  return kBackwardKernels[static_cast<std::size_t>(kernel)].name;
}

constexpr std::optional<BackwardKernel> find_backward_kernel(std::string_view name) {
  for (const BackwardKernelName& row : kBackwardKernels) {
    if (row.name == name) return row.kernel;
  }
  return std::nullopt;
}

}  // namespace b3dgs
