// Backward blend, per-splat. All buckets have the same size, so the launch is balanced by construction.
//
// Kernel 1, sum_behind: for each pixel and bucket, the state behind the bucket: transmittance, and S of blend.h.
//   Block: 32 pixels of a tile, a lane each; its 8 warps split the pixels' buckets into 8 chunks.
//   Each warp sums the parts of its chunk, which the forward pass stored. With the sums of the chunks behind its own,
//     from shared memory, it then walks its buckets back to front and writes the state behind each.
//   Barriers: one, between the two phases.
//
// Kernel 2, backward_per_splat: a warp per bucket (32 list entries), a lane per splat.
//   The tile's pixels stream through the lanes: a pixel enters the last lane with its state behind the bucket, and each
//     step passes (transmittance, S) to the lane below, so that every splat meets the pixel in reverse list order.
//   Each lane sums its splat's gradient in registers and adds it to memory once, with three vector atomics; if
//     gradients must be deterministic, it stores it in the pair's slot instead.
//   Pixels that finished before the bucket, and sub-tiles of 8 x 4 pixels that no splat of it reaches, are left out.
//   Shared memory: a ring of 128 pixels per warp. Barriers: only within the warp, around writes to the ring.

#include "raster/cuda/backward/splat_grad.cuh"
#include "raster/cuda/blend_kernels.h"
#include "raster/cuda/forward/tile_blend.cuh"
#include "raster/cuda/launch.cuh"

namespace b3dgs::cuda {
namespace {

constexpr int kWarps = 4;  // per block
// Capacity of a warp's ring of pixels: 31 still in the lanes, up to 31 waiting, and 32 just added.
constexpr int kRing = 128;
static_assert(kRing >= 31 + 31 + kWarpSize && (kRing & (kRing - 1)) == 0, "slots are computed with a bit mask");

/// Pixels that stream through the lanes of one warp.
struct PixelRing {
  float2 center[kRing];
  std::int32_t last[kRing];
  float2 state[kRing];  // transmittance, behind
  float4 color[kRing];  // gradient with respect to red, green, blue; depth
};

constexpr int kChunks = 8;  // warps of a block of sum_behind_kernel: chunks of a pixel's buckets summed in parallel

/// Transmittance of a pixel in front of each segment of its list, by which the segment's bucket parts must be
/// multiplied (kernel segmented); 1 for lists that are not cut.
template <int kTilePixels>
class TransmittanceBefore {
 public:
  __device__ __forceinline__ TransmittanceBefore(const BucketParts& parts, std::int32_t tile,
                                                 std::int32_t pixel_index) {
    const std::int32_t first = parts.first_segment_of_tile != nullptr ? parts.first_segment_of_tile[tile] : -1;
    if (first >= 0) fronts_ = parts.segment_fronts + std::int64_t{first} * kTilePixels + pixel_index;
  }
  __device__ __forceinline__ float of_bucket(std::int32_t bucket) const {
    constexpr int kBuckets = kSegmentEntries / kWarpSize;
    return fronts_ != nullptr ? __ldg(&fronts_[std::int64_t{bucket / kBuckets} * kTilePixels].value) : 1.0f;
  }

 private:
  const SegmentFront* fronts_ = nullptr;  // null if the list is not cut
};

/// Sum of weight * value (blend.h) over a bucket's splats at a pixel: dot(dL/dcolour, colour part) + depth term.
template <bool kWithDepth>
__device__ __forceinline__ float loss_of_bucket(const BlendBackwardCudaArgs& args, std::int64_t index, float4 part,
                                                const PixelGrad& g) {
  float sum = g.color.x * part.y + g.color.y * part.z + g.color.z * part.w;
  if constexpr (kWithDepth) sum += g.depth * __ldg(args.parts.depth + index);
  return sum;
}

/// Writes bucket_ends: transmittance and S behind each bucket of each pixel.
template <int kTilePixels, bool kWithDepth>
__global__ void __launch_bounds__(kChunks* kWarpSize) sum_behind_kernel(const BlendBackwardCudaArgs args) {
  constexpr int kGroups = kTilePixels / kWarpSize;
  __shared__ float chunk_sums[kChunks][kWarpSize];
  const BlendBackwardArgs& blend = args.blend;
  const auto tile = static_cast<std::int32_t>(blockIdx.x) / kGroups;
  const int chunk = static_cast<int>(threadIdx.x) / kWarpSize, lane = lane_id();
  const TilePixel at = tile_pixel(blend.grid, tile, static_cast<std::int32_t>(blockIdx.x) % kGroups * kWarpSize + lane);
  const std::int64_t pixel = static_cast<std::int64_t>(at.y) * blend.grid.image_width + at.x;
  const std::int32_t last = at.inside ? blend.last_ids[pixel] : -1;
  const PixelGrad g = last >= 0 ? load_pixel_grad(blend, pixel) : PixelGrad{};

  const std::int32_t n = last >= 0 ? last / kWarpSize + 1 : 0, per_chunk = (n + kChunks - 1) / kChunks;
  const std::int32_t begin = chunk * per_chunk, end = begin + per_chunk < n ? begin + per_chunk : n;
  const std::int64_t first = args.buckets.offsets[tile] * kTilePixels + at.index;
  const TransmittanceBefore<kTilePixels> transmittance_before(args.parts, tile, at.index);
  float sum = 0;
#pragma unroll 8
  for (std::int32_t bucket = end - 1; bucket >= begin; --bucket) {
    const std::int64_t index = first + std::int64_t{bucket} * kTilePixels;
    sum += transmittance_before.of_bucket(bucket) *
           loss_of_bucket<kWithDepth>(args, index, __ldg(args.parts.color + index), g);
  }
  chunk_sums[chunk][lane] = sum;
  __syncthreads();  // sums of all chunks
  if (last < 0) return;
  float behind = loss_behind_list(blend, pixel, g);
  for (int later = kChunks - 1; later > chunk; --later) behind += chunk_sums[later][lane];
#pragma unroll 8
  for (std::int32_t bucket = end - 1; bucket >= begin; --bucket) {
    const std::int64_t index = first + std::int64_t{bucket} * kTilePixels;
    const float4 part = __ldg(args.parts.color + index);
    const float before = transmittance_before.of_bucket(bucket);
    args.bucket_ends[index] = make_float2(before * part.x, behind);
    behind += before * loss_of_bucket<kWithDepth>(args, index, part, g);
  }
}

/// Kernel 2 for one warp: a bucket of a tile's list, whose pixels stream through the lanes.
///
///      tile               ring                     lane 31      lane 30             lane 0
///   sub-tiles  ---> | p7 | p6 | p5 | p4 | --->    splat 31 ---> splat 30 ---> ... ---> splat 0 --->
///                    n_added      next to enter      p3           p2                      p0
///
/// advance() moves every pixel to the lane below. What moves is the pixel's state (transmittance, S), which each splat
/// changes; the rest of the pixel stays in the ring until it has left lane 0.
template <int kTilePixels, bool kWithDepth>
class BucketStream {
 public:
  __device__ __forceinline__ BucketStream(const BlendBackwardCudaArgs& args, PixelRing& ring, std::int64_t bucket)
      : args_(args), ring_(ring), bucket_(bucket), tile_(args.buckets.tile_of_bucket[bucket]) {
    begin_ = static_cast<std::int32_t>((bucket - args.buckets.offsets[tile_]) * kWarpSize);
    const BlendBackwardArgs& blend = args.blend;
    first_ = blend.bins.tile_offsets[tile_];
    const auto n = static_cast<std::int32_t>(blend.bins.tile_offsets[tile_ + 1] - first_);
    position_ = begin_ + lane_;
    if (position_ < n) {
      id_ = blend.bins.splat_ids[first_ + position_];
      const SplatMean mean = load_mean(blend.splats, id_);
      shape_ = make_splat_shape(mean, load_conic(blend.splats, id_));
      color_ = load_color(blend.splats, id_).v;
      depth_ = mean.v.w;
      const float2 extent = __ldg(reinterpret_cast<const float2*>(blend.extents) + id_);
#pragma unroll
      for (int sub_tile = 0; sub_tile < kTilePixels / kWarpSize; ++sub_tile) {
        const TilePixel corner = tile_pixel(blend.grid, tile_, sub_tile_pixel(sub_tile * kWarpSize));
        if (reaches_sub_tile(mean.v.x, mean.v.y, extent, corner.center_x(), corner.center_y())) {
          sub_tiles_ |= 1u << sub_tile;
        }
      }
    }
    sub_tiles_ = warp_or(sub_tiles_);
  }

  /// Lets all pixels pass all lanes.
  __device__ __forceinline__ void run() {
    // Keep at least 32 pixels ahead, then step through all that are there; finally let the last 31 pass the lanes.
    while (true) {
      while (sub_tiles_ != 0 && n_added_ - step_ < kWarpSize) add_sub_tile();
      if (step_ >= n_added_) break;
      for (const int end = n_added_; step_ < end;) advance();
      __syncwarp();  // all lanes have finished with pixels that the next sub-tile may overwrite
    }
    if (n_added_ > 0) {
      for (const int end = n_added_ + kWarpSize - 1; step_ < end;) advance();
    }
  }

  /// Adds the gradient of this lane's splat to memory.
  __device__ __forceinline__ void store() const {
    if (id_ < 0) return;
    if (sum_.log_alpha == 0 && sum_.red == 0 && sum_.green == 0 && sum_.blue == 0 && sum_.depth == 0) return;
    if (args_.pair_grads != nullptr) {
      args_.pair_grads[args_.blend.bins.pair_slots[first_ + position_]] = {sum_, {0, 0}};
    } else {
      atomic_add(args_.splat_grads + id_, sum_);
    }
  }

 private:
  /// Adds the pixels of the next sub-tile that did not finish before the bucket to the ring.
  __device__ __forceinline__ void add_sub_tile() {
    const BlendBackwardArgs& blend = args_.blend;
    const int sub_tile = __ffs(sub_tiles_) - 1;
    sub_tiles_ &= sub_tiles_ - 1;
    const TilePixel at = tile_pixel(blend.grid, tile_, sub_tile_pixel(sub_tile * kWarpSize + lane_));
    const std::int64_t pixel = static_cast<std::int64_t>(at.y) * blend.grid.image_width + at.x;
    const std::int32_t last = at.inside ? blend.last_ids[pixel] : -1;
    const bool alive = last >= begin_;
    const unsigned living = __ballot_sync(kFullWarp, alive);
    if (alive) {
      const PixelGrad g = load_pixel_grad(blend, pixel);
      const int index = (n_added_ + __popc(living & ((1u << lane_) - 1))) % kRing;
      ring_.center[index] = make_float2(at.center_x(), at.center_y());
      ring_.last[index] = last;
      ring_.state[index] = args_.bucket_ends[bucket_ * kTilePixels + at.index];
      ring_.color[index] = make_float4(g.color.x, g.color.y, g.color.z, g.depth);
    }
    n_added_ += __popc(living);
    __syncwarp();  // the pixels are visible to all lanes
  }

  /// One step: every pixel moves one lane down, and each lane handles the pixel that it now has.
  __device__ __forceinline__ void advance() {
    state_.transmittance = __shfl_down_sync(kFullWarp, state_.transmittance, 1);
    state_.behind = __shfl_down_sync(kFullWarp, state_.behind, 1);
    const int pixel = step_ - (kWarpSize - 1 - lane_);
    const int index = pixel & (kRing - 1);
    ++step_;
    if (pixel < 0 || pixel >= n_added_) return;
    if (lane_ == kWarpSize - 1) {
      const float2 entering = ring_.state[index];
      state_ = {entering.x, entering.y};
    }
    const float2 center = ring_.center[index];
    const Footprint<float> footprint = evaluate_footprint(shape_, center.x, center.y);
    if (!footprint.contributes || position_ > ring_.last[index]) return;
    const float4 g = ring_.color[index];
    float value = g.x * color_.x + g.y * color_.y + g.z * color_.z;
    if constexpr (kWithDepth) value += g.w * depth_;
    const BlendGrad<float> part = blend_over_reverse(state_, true, evaluate_alpha(footprint.power), value);
    accumulate(sum_, footprint, part, g.x, g.y, g.z, g.w);
  }

  const BlendBackwardCudaArgs& args_;
  PixelRing& ring_;
  const int lane_ = lane_id();
  // The bucket:
  const std::int64_t bucket_;
  const std::int32_t tile_;
  std::int64_t first_;      // first pair of the tile's list
  std::int32_t begin_;      // position in the list of the bucket's first pair
  unsigned sub_tiles_ = 0;  // a bit for each that any splat of the bucket reaches and that is not yet added
  // This lane's splat:
  std::int32_t position_;  // in the list
  std::int32_t id_ = -1;   // -1: beyond the end of the list
  SplatShape<float> shape_{};
  float4 color_{};
  float depth_ = 0;
  SplatGrad sum_{};
  // The stream:
  ReverseState<float> state_{};  // of the pixel that is in this lane
  int step_ = 0;                 // number of steps so far: the pixel that enters the last lane next
  int n_added_ = 0;              // pixels added to the ring so far
};

template <int kTilePixels, bool kWithDepth>
__global__ void __launch_bounds__(kWarps* kWarpSize) backward_per_splat_kernel(const BlendBackwardCudaArgs args) {
  __shared__ PixelRing rings[kWarps];
  const std::int64_t bucket = static_cast<std::int64_t>(blockIdx.x) * kWarps + threadIdx.x / kWarpSize;
  if (bucket >= static_cast<std::int64_t>(*args.buckets.n)) return;
  BucketStream<kTilePixels, kWithDepth> stream(args, rings[threadIdx.x / kWarpSize], bucket);
  stream.run();
  stream.store();
}

template <int kTilePixels, bool kWithDepth>
void launch(const BlendBackwardCudaArgs& args, const LaunchContext& context) {
  const int n_groups = args.blend.grid.n_tiles() * (kTilePixels / kWarpSize);
  sum_behind_kernel<kTilePixels, kWithDepth><<<n_groups, kChunks * kWarpSize, 0, context.stream>>>(args);
  B3DGS_CUDA_CHECK_LAUNCH();
  const auto blocks = static_cast<unsigned>((args.buckets.n_max + kWarps - 1) / kWarps);
  backward_per_splat_kernel<kTilePixels, kWithDepth><<<blocks, kWarps * kWarpSize, 0, context.stream>>>(args);
  B3DGS_CUDA_CHECK_LAUNCH();
}

}  // namespace

void launch_backward_per_splat(const BlendBackwardCudaArgs& args, const LaunchContext& context) {
  if (args.buckets.n_max == 0) return;
  with_tile_pixels(args.blend.grid.tile, [&](auto pixels) {
    if (args.blend.grad.depth != nullptr) {
      launch<pixels.value, true>(args, context);
    } else {
      launch<pixels.value, false>(args, context);
    }
  });
}

KernelResources backward_per_splat_resources(const TileShape& tile) {
  return tile_kernel_resources(
      tile, [](auto pixels) { return backward_per_splat_kernel<pixels.value, false>; }, kWarps * kWarpSize);
}

}  // namespace b3dgs::cuda
