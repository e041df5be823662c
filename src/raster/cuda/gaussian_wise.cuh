// Gaussian-wise blending: a warp blends one pixel, a lane for each of 32 splats, with a prefix product where a single
// thread would have a chain.
#pragma once

#include "raster/cuda/tile_blend.cuh"

namespace b3dgs::cuda {

/// What a lane brings to a group. Positions rise from lane to lane.
struct LaneSplat {
  bool contributes;
  float power;            // log2 of the uncapped alpha
  std::int32_t position;  // in the tile's list
};

/// A pixel that a warp blends group by group. Transmittance, last and finished are the same in all lanes; colour and
/// depth stay spread over the lanes until the end.
template <bool kKeepParts>
class GaussianWisePixel {
 public:
  __device__ GaussianWisePixel(const BlendForwardCudaArgs& args, std::int32_t tile, const TilePixel& at)
      : args_(args), tile_(tile), at_(at) {}

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
      last_ = __shfl_sync(kFullWarp, splat.position, 31 - __clz(blended));
      if constexpr (kKeepParts) keep_parts(own, splat.position / kWarpSize, blended);
    }
    finished_ = saturating != 0;
    transmittance_ = finished_ ? __shfl_sync(kFullWarp, before, stop) : __shfl_sync(kFullWarp, after, kWarpSize - 1);
  }

  /// Writes the pixel. For all lanes, once.
  __device__ __forceinline__ void store() const {
    const float4 sum = warp_sum(make_float4(part_.red, part_.green, part_.blue, part_.depth));
    const PixelState<float> pixel{transmittance_, sum.x, sum.y, sum.z, sum.w};
    if (lane_id() != 0) return;
    if (kKeepParts && open_bucket_ >= 0) store_part(open_bucket_, open_);
    store_pixel(args_.blend, at_, pixel, last_);
  }

 private:
  __device__ void store_part(std::int32_t bucket, const PixelState<float>& part) const {
    store_bucket_part(args_, tile_, std::int64_t{bucket} * kWarpSize, at_.index, part);
  }

  /// Sums the lanes bucket by bucket and writes each bucket that is complete. The last one stays open, for the next
  /// group may go on with it.
  __device__ __forceinline__ void keep_parts(PixelState<float> sum, std::int32_t bucket, unsigned blended) {
    const int lane = lane_id();
    const bool accepted = (blended >> lane & 1) != 0;
    // Lanes that blended nothing count with the last that did, so that keys rise from lane to lane.
    const unsigned up_to_own = blended & (0xffffffffu >> (kWarpSize - 1 - lane));
    const int source = up_to_own != 0 ? 31 - __clz(up_to_own) : 0;
    const std::int32_t nearest = __shfl_sync(kFullWarp, bucket, source);
    const std::int32_t key = up_to_own != 0 ? nearest : open_bucket_;
    sum.transmittance = __shfl_sync(kFullWarp, sum.transmittance, source);
    if (lane == 0 && key != open_bucket_ && open_bucket_ >= 0) store_part(open_bucket_, open_);
    const bool goes_on = key == open_bucket_ && open_bucket_ >= 0;
    const std::int32_t before = __shfl_up_sync(kFullWarp, key, 1);
    const std::int32_t gap_begin = (lane == 0 ? open_bucket_ : before) + 1;
    if (accepted) {
      for (std::int32_t empty = gap_begin; empty < key; ++empty) store_part(empty, {1, 0, 0, 0, 0});
    }
#pragma unroll
    for (int distance = 1; distance < kWarpSize; distance *= 2) {
      const std::int32_t other = __shfl_up_sync(kFullWarp, key, distance);
      const PixelState<float> front{
          1, __shfl_up_sync(kFullWarp, sum.red, distance), __shfl_up_sync(kFullWarp, sum.green, distance),
          __shfl_up_sync(kFullWarp, sum.blue, distance), __shfl_up_sync(kFullWarp, sum.depth, distance)};
      if (lane >= distance && other == key) {
        sum = {sum.transmittance, sum.red + front.red, sum.green + front.green, sum.blue + front.blue,
               sum.depth + front.depth};
      }
    }
    if (goes_on) {
      sum = {sum.transmittance, sum.red + open_.red, sum.green + open_.green, sum.blue + open_.blue,
             sum.depth + open_.depth};
    }
    const std::int32_t next = __shfl_down_sync(kFullWarp, key, 1);
    if (lane < kWarpSize - 1 && next != key && key >= 0) store_part(key, sum);
    open_bucket_ = __shfl_sync(kFullWarp, key, kWarpSize - 1);
    open_ = {__shfl_sync(kFullWarp, sum.transmittance, kWarpSize - 1), __shfl_sync(kFullWarp, sum.red, kWarpSize - 1),
             __shfl_sync(kFullWarp, sum.green, kWarpSize - 1), __shfl_sync(kFullWarp, sum.blue, kWarpSize - 1),
             __shfl_sync(kFullWarp, sum.depth, kWarpSize - 1)};
  }

  const BlendForwardCudaArgs& args_;
  const std::int32_t tile_;
  const TilePixel at_;
  float transmittance_ = 1;
  std::int32_t last_ = -1;
  bool finished_ = false;
  PixelState<float> part_{1, 0, 0, 0, 0};  // of the own lane; its transmittance is not used
  std::int32_t open_bucket_ = -1;          // whose part is not written yet; the same in all lanes, as is open_
  PixelState<float> open_{1, 0, 0, 0, 0};
};

}  // namespace b3dgs::cuda
