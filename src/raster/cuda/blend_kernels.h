// Our blending kernels on CUDA, generated from the table in raster/kernels.h, and their scratch memory.
#pragma once

#include <array>

#include "raster/cuda/passes.h"
#include "raster/kernels.h"
#include "raster/math/tiling.h"

namespace b3dgs::cuda {

#define B3DGS_ROW(kernel, id, name, is_balanced, summary) \
  void launch_forward_##id(const BlendForwardCudaArgs& args, const LaunchContext& context);
B3DGS_OWN_KERNELS(B3DGS_ROW)
#undef B3DGS_ROW

/// Our kernels, in the order of ForwardKernel.
inline constexpr std::array kOwnLaunches{
#define B3DGS_ROW(kernel, id, name, is_balanced, summary) &launch_forward_##id,
    B3DGS_OWN_KERNELS(B3DGS_ROW)
#undef B3DGS_ROW
};

/// Queues the backward blend on our lists.
void launch_backward_per_bucket(const BlendBackwardCudaArgs& args, const LaunchContext& context);

/// Returns whether to sum the parts behind each bucket once. This requires that it is faster (docs/lab/kernels.md: on
/// street 1.5 M, not on 0.5 M) and that the sums fit into the memory in which pairs were sorted. Otherwise each bucket
/// sums those behind it. That saves a kernel, but takes time that grows with the square of the number of buckets.
inline bool has_many_parts(const ViewCounts& counts) {
  constexpr std::int64_t kSortBytes = 2 * sizeof(EntryKey), kSumBytes = kCudaTilePixels * sizeof(float);
  return counts.longest_list > 32768 && counts.n_buckets * kSumBytes <= counts.n_pairs * kSortBytes;
}

/// Sets the scratch pointers of `args`, whose other members must be set.
inline void take_forward_scratch(BlendForwardCudaArgs& args, ScratchArrays& arrays) {
  if (args.cut.cuts()) {
    // Each task has a full segment in front of it, because only the last segment of a list may be shorter.
    const std::int64_t n_tasks_max = args.blend.bins.n_pairs >> args.cut.entries_log2;
    const std::int64_t n = args.cut.segments_before(args.blend.bins.n_pairs), n_pixels = n * kCudaTilePixels;
    Segments& segments = args.segments;
    segments.n_max = static_cast<std::int32_t>(n);
    segments.n_tasks_max = static_cast<std::int32_t>(n_tasks_max);
    segments.tasks = arrays.take<SegmentTask>(n_tasks_max);
    segments.n_tasks = arrays.take<std::int32_t>(1);
    segments.n_long = arrays.take<std::int32_t>(1);
    segments.hidden_from = arrays.take<std::int32_t>(std::int64_t{kSegmentBlocks} * args.blend.grid.n_tiles());
    segments.is_done = arrays.take<std::int32_t>(kSegmentBlocks * n);
    segments.transmittance = arrays.take<float>(n_pixels);
    segments.color_depth = arrays.take<float4>(n_pixels);
    segments.last = arrays.take<std::int32_t>(n_pixels);
  }
}

}  // namespace b3dgs::cuda
