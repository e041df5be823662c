// State of a pixel behind a bucket, from the parts of the buckets behind it that the forward pass stored.
#pragma once

#include "raster/cuda/backward/splat_grad.cuh"
#include "raster/cuda/passes.h"
#include "raster/math/tiling.h"

namespace b3dgs::cuda {

/// Index of the bucket with a pixel's last splat: number of parts behind the first.
__device__ __forceinline__ std::int32_t last_bucket(std::int32_t last) {
  return last / kBucketEntries;
}

/// The parts of one pixel.
template <bool kWithDepth>
class PixelParts {
 public:
  __device__ __forceinline__ PixelParts(const BlendBackwardCudaArgs& args, std::int32_t tile, std::int32_t pixel_index)
      : parts_(args.parts), first_(args.buckets.offsets[tile] * kCudaTilePixels + pixel_index) {
    const std::int32_t segment = parts_.first_segment_of_tile != nullptr ? parts_.first_segment_of_tile[tile] : -1;
    if (segment >= 0) fronts_ = parts_.segment_fronts + std::int64_t{segment} * kCudaTilePixels + pixel_index;
  }
  /// Index of a bucket's part.
  __device__ __forceinline__ std::int64_t index(std::int32_t bucket) const {
    return first_ + std::int64_t{bucket} * kCudaTilePixels;
  }
  struct Part {
    float4 color;
    float depth, front;
  };
  __device__ __forceinline__ Part load(std::int32_t bucket) const {
    return {__ldg(parts_.color + index(bucket)), kWithDepth ? __ldg(parts_.depth + index(bucket)) : 0.0f,
            front(bucket)};
  }
  /// What the part adds to the loss, as `behind` of ReverseState.
  __device__ static __forceinline__ float loss(const Part& part, const PixelGrad& g) {
    float sum = g.color.x * part.color.y + g.color.y * part.color.z + g.color.z * part.color.w;
    if constexpr (kWithDepth) sum += g.depth * part.depth;
    return part.front * sum;
  }
  /// The transmittance behind a bucket.
  __device__ __forceinline__ float transmittance(std::int32_t bucket) const {
    return front(bucket) * __ldg(&parts_.color[index(bucket)].x);
  }

 private:
  /// Segments::fronts: the transmittance in front of the bucket's segment; 1 if the list is not cut.
  __device__ __forceinline__ float front(std::int32_t bucket) const {
    return fronts_ != nullptr ? __ldg(fronts_ + std::int64_t{bucket >> parts_.segment_buckets_log2} * kCudaTilePixels)
                              : 1.0f;
  }

  const BucketParts& parts_;
  const std::int64_t first_;
  const float* fronts_ = nullptr;  // null if the list is not cut
};

/// State behind a bucket in front of the pixel's last. `is_summed`: sum_behind.cu has added up the list's parts.
/// `behind_list`: loss_behind_list().
template <bool kWithDepth>
__device__ __forceinline__ ReverseState<float> state_behind(const BlendBackwardCudaArgs& args, bool is_summed,
                                                            std::int32_t tile, std::int32_t bucket,
                                                            std::int32_t pixel_index, std::int32_t last,
                                                            const PixelGrad& g, float behind_list) {
  const PixelParts<kWithDepth> parts(args, tile, pixel_index);
  float behind = behind_list;
  if (is_summed) {
    behind = args.behind[parts.index(bucket)];
  } else {
    for (std::int32_t k = last_bucket(last); k > bucket; --k) behind += parts.loss(parts.load(k), g);
  }
  return {parts.transmittance(bucket), behind};
}

}  // namespace b3dgs::cuda
