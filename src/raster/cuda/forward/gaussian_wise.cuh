// Gaussian-wise blending: a warp blends one pixel, 32 splats (a group) at a time, a lane each. The transmittance in
// front of each lane is a prefix product of 1 - alpha, where a single thread would need 32 dependent steps.
#pragma once

#include <type_traits>

#include "raster/cuda/forward/tile_blend.cuh"

namespace b3dgs::cuda {

/// A lane's splat of a group. Positions increase from lane to lane.
struct LaneSplat {
  bool contributes;
  float power;            // log2 of the uncapped alpha
  std::int32_t position;  // in the tile's list
};

/// Which BucketParts a kernel writes. Depth costs an additional warp sum, and training needs no gradient with respect
/// to depth.
enum class StoredParts { kNone, kColor, kColorAndDepth };

/// Calls launch(std::integral_constant<StoredParts, ...>()) according to which buffers there are.
template <class Launch>
void with_stored_parts(const BucketParts& parts, Launch&& launch) {
  if (parts.color == nullptr) {
    launch(std::integral_constant<StoredParts, StoredParts::kNone>());
  } else if (parts.depth == nullptr) {
    launch(std::integral_constant<StoredParts, StoredParts::kColor>());
  } else {
    launch(std::integral_constant<StoredParts, StoredParts::kColorAndDepth>());
  }
}

/// A pixel that a warp blends group by group. Transmittance, last and finished are the same in all lanes; colour and
/// depth are partial sums per lane until store().
template <StoredParts kStored>
class GaussianWisePixel {
 public:
  __device__ GaussianWisePixel(const BlendForwardCudaArgs& args, std::int32_t tile, const TilePixel& at)
      : args_(args), at_(at) {
    if constexpr (kStored != StoredParts::kNone) first_part_ = bucket_part_index(args, tile, 0, at.index);
  }

  __device__ bool is_finished() const { return finished_; }

  /// Blends a group. The pixel must not be finished. `color_depth()` returns the lane's red, green, blue and depth; it
  /// is called only by lanes whose splat is blended.
  template <class ColorDepth>
  __device__ __forceinline__ void blend(const LaneSplat& splat, ColorDepth&& color_depth) {
    const int lane = lane_id();
    const float alpha = splat.contributes ? evaluate_alpha(splat.power).alpha : 0.0f;
    // A splat that does not contribute has alpha 0, a factor of 1.
    const float after = transmittance_ * warp_prefix(1 - alpha, [](float a, float b) { return a * b; });
    float before = __shfl_up_sync(kFullWarp, after, 1);
    if (lane == 0) before = transmittance_;
    // The first lane that would bring the transmittance below the minimum finishes the pixel.
    const unsigned saturating = __ballot_sync(kFullWarp, splat.contributes && is_saturated(after));
    const int stop = saturating != 0 ? __ffs(saturating) - 1 : kWarpSize;
    const bool accepted = splat.contributes && lane < stop;
    PixelState<float> added{after, 0, 0, 0, 0};
    if (accepted) {
      const float4 color = color_depth();
      const float weight = before * alpha;
      added = {after, weight * color.x, weight * color.y, weight * color.z, weight * color.w};
      part_ = {1, part_.red + added.red, part_.green + added.green, part_.blue + added.blue, part_.depth + added.depth};
    }
    const unsigned blended = __ballot_sync(kFullWarp, accepted);
    if (blended != 0) {
      const int end = kWarpSize - __clz(blended);
      if constexpr (kStored != StoredParts::kNone) store_parts(added, bucket_of(splat.position), end);
      last_ = __shfl_sync(kFullWarp, splat.position, end - 1);
    }
    finished_ = saturating != 0;
    transmittance_ = finished_ ? __shfl_sync(kFullWarp, before, stop) : __shfl_sync(kFullWarp, after, kWarpSize - 1);
  }

  /// Writes the pixel, and its last bucket part. Must be called once, by all lanes.
  __device__ __forceinline__ void store() const {
    const float4 sum = warp_sum(make_float4(part_.red, part_.green, part_.blue, part_.depth));
    const PixelState<float> pixel{transmittance_, sum.x, sum.y, sum.z, sum.w};
    if (lane_id() != 0) return;
    if constexpr (kStored != StoredParts::kNone) {
      if (last_ >= 0) store_part(bucket_of(last_), open_);
    }
    store_pixel(args_.blend, at_, pixel, last_);
  }

 private:
  __device__ static std::int32_t bucket_of(std::int32_t position) {
    return position >= 0 ? position / kBucketEntries : -1;
  }

  __device__ __forceinline__ void store_part(std::int32_t bucket, const PixelState<float>& part) const {
    const TileShape shape = args_.blend.grid.tile;
    const std::int64_t at = first_part_ + std::int64_t{bucket} * (shape.width * shape.height);
    args_.parts.color[at] = make_float4(magnitude(part.transmittance), part.red, part.green, part.blue);
    if constexpr (kStored == StoredParts::kColorAndDepth) args_.parts.depth[at] = part.depth;
  }

  /// The sums of another lane: shuffle(sum) for each.
  template <class Shuffle>
  __device__ static __forceinline__ PixelState<float> of_lane(const PixelState<float>& sum, Shuffle&& shuffle) {
    PixelState<float> other{1, shuffle(sum.red), shuffle(sum.green), shuffle(sum.blue), 0};
    if constexpr (kStored == StoredParts::kColorAndDepth) other.depth = shuffle(sum.depth);
    return other;
  }

  /// Adds the lanes below `end` (lane end - 1 blended its splat) to bucket parts and writes each bucket that is
  /// complete. The last bucket stays open, since the next group may continue it. Must be called before last_ is
  /// updated.
  ///
  /// A group may span several buckets. This is a segmented prefix sum: the first lane of each bucket is a head, every
  /// lane adds the lanes down to its head, and the last lane of each complete bucket writes the sum.
  __device__ __forceinline__ void store_parts(PixelState<float> sum, std::int32_t bucket, int end) {
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
    // Buckets without a blended splat, between the previous bucket and this one.
    if (is_head) {
      for (std::int32_t empty = before + 1; empty < bucket; ++empty) store_part(empty, {1, 0, 0, 0, 0});
    }
    const unsigned heads = __ballot_sync(kFullWarp, is_head) | 1u;
    const int ahead = lane - (31 - __clz(heads & (kFullWarp >> (kWarpSize - 1 - lane))));  // lanes from the head
    // Small splats: a pixel blends few of a group's 32, so only the necessary rounds are run.
    const int most_ahead = warp_max(lane < end ? ahead : 0);
    for (int distance = 1; distance <= most_ahead; distance *= 2) {
      const PixelState<float> front =
          of_lane(sum, [&](float value) { return __shfl_up_sync(kFullWarp, value, distance); });
      if (distance <= ahead) sum = sum_of(front, sum);
    }
    if (lane + 1 < end && (heads >> (lane + 1) & 1) != 0) store_part(bucket, sum);
    open_ = of_lane(sum, [&](float value) { return __shfl_sync(kFullWarp, value, end - 1); });
    open_.transmittance = __shfl_sync(kFullWarp, sum.transmittance, end - 1);
  }

  const BlendForwardCudaArgs& args_;
  const TilePixel at_;
  float transmittance_ = 1;
  std::int32_t last_ = -1;
  bool finished_ = false;
  PixelState<float> part_{1, 0, 0, 0, 0};  // this lane's sums; its transmittance is not used
  std::int64_t first_part_ = 0;            // index of the first bucket's part
  // Part of the bucket of last_, not written yet; the same in all lanes.
  PixelState<float> open_{1, 0, 0, 0, 0};
};

}  // namespace b3dgs::cuda
