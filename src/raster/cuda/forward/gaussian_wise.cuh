// Gaussian-wise blending: a warp blends one pixel, a lane for each of 32 splats, with a prefix product where a single
// thread would have a chain.
#pragma once

#include <type_traits>

#include "raster/cuda/forward/tile_blend.cuh"

namespace b3dgs::cuda {

/// What a lane brings to a group. Positions rise from lane to lane.
struct LaneSplat {
  bool contributes;
  float power;            // log2 of the uncapped alpha
  std::int32_t position;  // in the tile's list
};

/// Which of the BucketParts a kernel writes. Depths cost the warp a fourth sum, and training rarely asks for them.
enum class KeptParts { kNone, kLight, kLightAndDepth };

template <KeptParts kKept>
using KeptPartsConstant = std::integral_constant<KeptParts, kKept>;

/// Calls `launch` with the constant that fits the buffers.
template <class Launch>
void with_kept_parts(const BucketParts& parts, Launch&& launch) {
  if (parts.light == nullptr) {
    launch(KeptPartsConstant<KeptParts::kNone>());
  } else if (parts.depth == nullptr) {
    launch(KeptPartsConstant<KeptParts::kLight>());
  } else {
    launch(KeptPartsConstant<KeptParts::kLightAndDepth>());
  }
}

/// A pixel that a warp blends group by group. Transmittance, last and finished are the same in all lanes; colour and
/// depth stay spread over the lanes until the end.
template <KeptParts kKept>
class GaussianWisePixel {
 public:
  __device__ GaussianWisePixel(const BlendForwardCudaArgs& args, std::int32_t tile, const TilePixel& at)
      : args_(args), at_(at) {
    if constexpr (kKept != KeptParts::kNone) first_part_ = bucket_part_index(args, tile, 0, at.index);
  }

  __device__ bool is_finished() const { return finished_; }

  /// Blends up to 32 splats. Not for finished pixels. `shown()` gives the own splat's red, green, blue and depth; it is
  /// asked only where the splat is blended.
  template <class Shown>
  __device__ __forceinline__ void blend(const LaneSplat& splat, Shown&& shown) {
    const int lane = lane_id();
    const float alpha = splat.contributes ? evaluate_alpha(splat.power).alpha : 0.0f;
    // A splat that does not contribute lets all light through: 1 - 0.
    const float after = transmittance_ * warp_prefix_product(1 - alpha);
    float before = __shfl_up_sync(kFullWarp, after, 1);
    if (lane == 0) before = transmittance_;
    const unsigned saturating = __ballot_sync(kFullWarp, splat.contributes && after < kTransmittanceMin);
    const int stop = saturating != 0 ? __ffs(saturating) - 1 : kWarpSize;
    const bool accepted = splat.contributes && lane < stop;
    PixelState<float> own{after, 0, 0, 0, 0};
    if (accepted) {
      const float4 color = shown();
      const float weight = before * alpha;
      own = {after, weight * color.x, weight * color.y, weight * color.z, weight * color.w};
      part_ = {1, part_.red + own.red, part_.green + own.green, part_.blue + own.blue, part_.depth + own.depth};
    }
    const unsigned blended = __ballot_sync(kFullWarp, accepted);
    if (blended != 0) {
      const int end = kWarpSize - __clz(blended);
      if constexpr (kKept != KeptParts::kNone) keep_parts(own, bucket_of(splat.position), end);
      last_ = __shfl_sync(kFullWarp, splat.position, end - 1);
    }
    finished_ = saturating != 0;
    transmittance_ = finished_ ? __shfl_sync(kFullWarp, before, stop) : __shfl_sync(kFullWarp, after, kWarpSize - 1);
  }

  /// Writes the pixel. For all lanes, once.
  __device__ __forceinline__ void store() const {
    const float4 sum = warp_sum(make_float4(part_.red, part_.green, part_.blue, part_.depth));
    const PixelState<float> pixel{transmittance_, sum.x, sum.y, sum.z, sum.w};
    if (lane_id() != 0) return;
    if constexpr (kKept != KeptParts::kNone) {
      if (last_ >= 0) store_part(bucket_of(last_), open_);
    }
    store_pixel(args_.blend, at_, pixel, last_);
  }

 private:
  __device__ static std::int32_t bucket_of(std::int32_t position) { return position >= 0 ? position / kWarpSize : -1; }

  __device__ __forceinline__ void store_part(std::int32_t bucket, const PixelState<float>& part) const {
    const TileShape shape = args_.blend.grid.tile;
    const std::int64_t at = first_part_ + std::int64_t{bucket} * (shape.width * shape.height);
    args_.parts.light[at] = make_float4(magnitude(part.transmittance), part.red, part.green, part.blue);
    if constexpr (kKept == KeptParts::kLightAndDepth) args_.parts.depth[at] = part.depth;
  }

  __device__ static __forceinline__ PixelState<float> sum_of(const PixelState<float>& front,
                                                             const PixelState<float>& back) {
    return {back.transmittance, back.red + front.red, back.green + front.green, back.blue + front.blue,
            back.depth + front.depth};
  }

  /// Of the lane that is `distance` ahead; not the transmittance.
  __device__ static __forceinline__ PixelState<float> sum_of_lane_ahead(const PixelState<float>& sum, int distance) {
    PixelState<float> other{1, __shfl_up_sync(kFullWarp, sum.red, distance),
                            __shfl_up_sync(kFullWarp, sum.green, distance),
                            __shfl_up_sync(kFullWarp, sum.blue, distance), 0};
    if constexpr (kKept == KeptParts::kLightAndDepth) other.depth = __shfl_up_sync(kFullWarp, sum.depth, distance);
    return other;
  }

  /// Sums the lanes before `end`, the last of which blended its splat, bucket by bucket, and writes each bucket that is
  /// complete. The last one stays open, for the next group may go on with it. Before last_ is moved on.
  __device__ __forceinline__ void keep_parts(PixelState<float> sum, std::int32_t bucket, int end) {
    const int lane = lane_id();
    std::int32_t before = __shfl_up_sync(kFullWarp, bucket, 1);
    if (lane == 0) {
      before = bucket_of(last_);
      if (bucket == before) {
        sum = sum_of(open_, sum);
      } else if (before >= 0) {
        store_part(before, open_);
      }
    }
    const bool is_head = lane < end && bucket != before;
    if (is_head) {
      for (std::int32_t empty = before + 1; empty < bucket; ++empty) store_part(empty, {1, 0, 0, 0, 0});
    }
    const unsigned heads = __ballot_sync(kFullWarp, is_head) | 1u;
    const int ahead = lane - (31 - __clz(heads & (kFullWarp >> (kWarpSize - 1 - lane))));  // lanes of the own bucket
    // Where splats are small a pixel sees few of a bucket's 32, and one or two rounds will do.
    const int most_ahead = warp_max(lane < end ? ahead : 0);
    for (int distance = 1; distance <= most_ahead; distance *= 2) {
      const PixelState<float> front = sum_of_lane_ahead(sum, distance);
      if (distance <= ahead) sum = sum_of(front, sum);
    }
    if (lane + 1 < end && (heads >> (lane + 1) & 1) != 0) store_part(bucket, sum);
    open_.transmittance = __shfl_sync(kFullWarp, sum.transmittance, end - 1);
    open_.red = __shfl_sync(kFullWarp, sum.red, end - 1);
    open_.green = __shfl_sync(kFullWarp, sum.green, end - 1);
    open_.blue = __shfl_sync(kFullWarp, sum.blue, end - 1);
    if constexpr (kKept == KeptParts::kLightAndDepth) open_.depth = __shfl_sync(kFullWarp, sum.depth, end - 1);
  }

  const BlendForwardCudaArgs& args_;
  const TilePixel at_;
  float transmittance_ = 1;
  std::int32_t last_ = -1;
  bool finished_ = false;
  PixelState<float> part_{1, 0, 0, 0, 0};  // of the own lane; its transmittance is not used
  std::int64_t first_part_ = 0;            // place of the first bucket's part
  // Of the bucket of last_, whose part is not written yet; the same in all lanes.
  PixelState<float> open_{1, 0, 0, 0, 0};
};

}  // namespace b3dgs::cuda
