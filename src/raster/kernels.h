// The table of blending kernels. Plain C++, so the command line, the kernel selector and their tests do not need CUDA.
//
// Kernels come in two families. A family has one tile shape and one backward kernel, so a view can be blended again
// with another kernel of its family, but not with one of the other family.
//
// To add a forward kernel of ours, add one row here, blend_forward_ID() in a source of cpu/forward, and
// launch_forward_ID() in one of cuda/forward.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string_view>

#include "core/check.h"

// ROW(enumerator, ID, name on the command line, is_balanced, one line for the help text)

/// The five kernels of Balanced 3DGS (arXiv 2412.17378), as printed.
#define B3DGS_PAPER_KERNELS(ROW)                                                                            \
  ROW(kNaive, naive, "naive", false, "paper: a thread per pixel, tiles assigned statically (the baseline)") \
  ROW(kDynamic, dynamic, "dynamic", true, "paper: as naive, with tiles taken from an atomic counter")       \
  ROW(kGaussianWise, gaussian_wise, "gaussian-wise", true,                                                  \
      "paper: a lane per Gaussian with prefix products, tiles assigned statically")                         \
  ROW(kCombined, combined, "combined", true,                                                                \
      "paper: a lane per Gaussian, tasks of 4 pixels from an atomic counter (its balanced kernel)")         \
  ROW(kSharedMemory, shared_memory, "shared-memory", false, "paper: as naive, with colours and depths staged too")

/// Our own kernels.
#define B3DGS_OWN_KERNELS(ROW)                                                                           \
  ROW(kSubTile, sub_tile, "sub-tile", false, "a thread per pixel, splats staged and culled by 8 x 4 px") \
  ROW(kSegmented, segmented, "segmented", true,                                                          \
      "as sub-tile, with long lists cut into segments that are blended in parallel")

#define B3DGS_FORWARD_KERNELS(ROW) B3DGS_PAPER_KERNELS(ROW) B3DGS_OWN_KERNELS(ROW)

namespace b3dgs {

/// Size of a tile, px.
struct TileShape {
  std::int32_t width = 16, height = 16;
};

enum class KernelFamily { kPaper, kOwn };

/// The tiles of each family. The paper's are its patches, a thread block of 128 pixels.
inline constexpr TileShape kPaperTile{16, 8}, kOwnTile{16, 16};
constexpr TileShape tile_of(KernelFamily family) {
  return family == KernelFamily::kPaper ? kPaperTile : kOwnTile;
}

/// The backward kernel of a family on a GPU. A CPU has one for both.
constexpr std::string_view backward_kernel_of(KernelFamily family) {
  return family == KernelFamily::kPaper ? "per-pixel" : "per-bucket";
}

/// All kernels compute the same image. README.md of this folder compares their schedules on CPU and CUDA.
enum class ForwardKernel {
#define B3DGS_ROW(kernel, id, name, is_balanced, summary) kernel,
  B3DGS_FORWARD_KERNELS(B3DGS_ROW)
#undef B3DGS_ROW
};

struct KernelRow {
  ForwardKernel kernel;
  std::string_view name;     // as on the command line
  bool is_balanced;          // balances the load between blocks, lanes or both: the subject of the paper
  std::string_view summary;  // one line for the help text
};

/// Indexed by ForwardKernel.
inline constexpr std::array kForwardKernels{
#define B3DGS_ROW(kernel, id, name, is_balanced, summary) KernelRow{ForwardKernel::kernel, name, is_balanced, summary},
    B3DGS_FORWARD_KERNELS(B3DGS_ROW)
#undef B3DGS_ROW
};

/// Used where kernels are not timed: in evaluation and in deterministic training.
inline constexpr ForwardKernel kStandardKernel = ForwardKernel::kSubTile;

constexpr KernelFamily family_of(ForwardKernel kernel) {
  return kernel < ForwardKernel::kSubTile ? KernelFamily::kPaper : KernelFamily::kOwn;
}

constexpr std::string_view kernel_name(ForwardKernel kernel) {
  return kForwardKernels[static_cast<std::size_t>(kernel)].name;
}

/// Returns the kernel with this name, or nullopt.
constexpr std::optional<ForwardKernel> find_kernel(std::string_view name) {
  for (const KernelRow& row : kForwardKernels) {
    if (row.name == name) return row.kernel;
  }
  return std::nullopt;
}

/// The same. @throws LogicError if there is none, because names from users are checked before
inline ForwardKernel kernel_named(std::string_view name) {
  const std::optional<ForwardKernel> kernel = find_kernel(name);
  B3DGS_CHECK(kernel.has_value(), "unknown kernel: ", name);
  return *kernel;
}

/// Returns whether this is the name of a balanced kernel. False if there is no such kernel.
constexpr bool is_balanced_kernel(std::string_view name) {
  const std::optional<ForwardKernel> kernel = find_kernel(name);
  return kernel && kForwardKernels[static_cast<std::size_t>(*kernel)].is_balanced;
}

}  // namespace b3dgs
