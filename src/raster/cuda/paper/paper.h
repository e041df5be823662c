// The kernels of Balanced 3DGS: how to launch them, and how well they fill the GPU. See README.md in this folder.
#pragma once

#include "raster/cuda/passes.h"
#include "raster/kernels.h"
#include "raster/rasterizer_backend.h"

namespace b3dgs::cuda {

/// Size of a patch in pixels, and threads of a block.
inline constexpr int kPatchWidth = kPaperTile.width, kPatchHeight = kPaperTile.height;
inline constexpr int kPatchThreads = kPatchWidth * kPatchHeight;
static_assert(kPatchWidth == 16 && kPatchHeight == 8, "the paper's experiment: 960 x 540 px are 60 x 68 patches");

/// When and where a block ran.
struct BlockRun {
  unsigned long long start, end;  // cycles of the multiprocessor's clock
  std::uint32_t multiprocessor;
};

struct PaperArgs {
  BlendForwardArgs blend{};
  std::int32_t* next_task = nullptr;  // [1] number of the next task, for kernels that take tasks
  BlockRun* runs = nullptr;           // [blocks] out, `end` zero before; null: not recorded
};

struct PaperKernel {
  void (*kernel)(PaperArgs) = nullptr;
  // True: as many blocks as are resident at once, which take tasks from `next_task`. False: a block per patch.
  bool takes_tasks = false;
};

#define B3DGS_ROW(kernel, id, name, is_balanced, summary) PaperKernel paper_##id();
B3DGS_PAPER_KERNELS(B3DGS_ROW)
#undef B3DGS_ROW

/// Queues one of the paper's kernels.
void launch_paper(ForwardKernel kernel, const PaperArgs& args, const LaunchContext& context);

/// Blends once and measures. Waits for the device.
KernelOccupancy measure_paper(ForwardKernel kernel, PaperArgs args, const LaunchContext& context);

/// Queues the backward blend on the same lists. Adds to args.splat_grads with atomics.
void launch_backward_per_pixel(const BlendBackwardCudaArgs& args, const LaunchContext& context);

}  // namespace b3dgs::cuda
