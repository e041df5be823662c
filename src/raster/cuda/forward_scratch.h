// Memory that forward schedules work in besides their arguments and results.
#pragma once

#include "raster/cuda/passes.h"
#include "raster/forward_kernel.h"

namespace b3dgs::cuda {

class ForwardScratch {
 public:
  /// Fills in what the kernel needs for a view whose other arguments are there. The backward pass after it needs the
  /// parts that parts_after() gives.
  void lend(ForwardKernel kernel, BlendForwardCudaArgs& args, const LaunchContext& context) {
    const std::int64_t tile_pixels = std::int64_t{args.blend.grid.tile.width} * args.blend.grid.tile.height;
    args.next_task = next_task_.resize(1, context);
    if (kernel == ForwardKernel::kCombined) {
      args.quad_words = quad_words_.resize(args.buckets.n_max * tile_pixels / 4, context);
    }
    if (kernel == ForwardKernel::kSegmented) {
      // All but the last of a list's segments are full, and each task has a full one before it.
      const std::int64_t n_tasks_max = args.blend.bins.n_isects / kSegmentEntries;
      const std::int64_t n = 2 * args.blend.bins.n_isects / kSegmentEntries, n_pixels = n * tile_pixels;
      args.segments = {static_cast<std::int32_t>(n_tasks_max),
                       tasks_.resize(n_tasks_max, context),
                       args.next_task,
                       first_of_tile_.resize(args.blend.grid.n_tiles(), context),
                       is_done_.resize(n, context),
                       before_.resize(n_pixels, context),
                       transmittance_.resize(n_pixels, context),
                       shown_.resize(n_pixels, context),
                       last_.resize(n_pixels, context)};
    }
  }

 private:
  DeviceBuffer<std::int32_t> next_task_, first_of_tile_, is_done_, last_;
  DeviceBuffer<std::uint32_t> quad_words_;
  DeviceBuffer<SegmentTask> tasks_;
  DeviceBuffer<float> before_, transmittance_;
  DeviceBuffer<float4> shown_;
};

/// What a forward pass with these arguments has kept for the backward pass.
inline BucketParts parts_after(ForwardKernel kernel, const BlendForwardCudaArgs& args) {
  BucketParts parts = args.parts;
  if (kernel == ForwardKernel::kSegmented) {
    parts.first_segment_of_tile = args.segments.first_of_tile;
    parts.before_segment = args.segments.before;
  }
  return parts;
}

}  // namespace b3dgs::cuda
