// Backward blend, per-bucket. A block per bucket (128 entries of a tile's list), so that long lists are split evenly.
//
//   Warp: a patch of the tile, 8 x 8 pixels. After the block has loaded the bucket's splats to shared memory, the four
//     warps work independently, from the last entry of the bucket to the first:
//
//     gather            blend                     sum rows                        add
//     lane: entry       lane: two pixels          lane: entry x two rows of 8 px  thread: entry
//
//     entries whose     8 at a time: weight and   their sums of weight times      the four patches' sums,
//     box reaches the   dL/d(ln alpha) of each    dL/d(colour), and moments of    to memory, with vector
//     patch, to a       pixel, to shared memory   dL/d(ln alpha)                  atomics or to the pair's slot
//     queue
//
//   Sums: with shuffles over 32 lanes, the ten sums of a splat would take 100 instructions. Through shared memory they
//     take twelve. A lane sums rows of 8 pixels, whose offsets from the patch's centre are constants, and the results
//     of four lanes are added.
//   State behind the bucket: if the pixel's last splat is in the bucket, it is the forward pass's final transmittance.
//     Otherwise it comes from the parts of the buckets behind, which the forward pass stored, or from their sum
//     (parts_behind.cuh).
//   Shared memory: BucketSplats, and PatchMemory for each warp. Barriers: one to stop if all pixels finish in front of
//     the bucket, one after the loads, one before the last phase.

#include "raster/cuda/backward/factored_sums.cuh"
#include "raster/cuda/backward/parts_behind.cuh"
#include "raster/cuda/backward/splat_grad.cuh"
#include "raster/cuda/blend_kernels.h"
#include "raster/cuda/forward/tile_blend.cuh"
#include "raster/cuda/launch.cuh"

namespace b3dgs::cuda {
namespace {

constexpr int kWarps = 4, kThreads = kWarps * kWarpSize;  // a warp per patch; in the last phase, a thread per entry
static_assert(kBucketEntries == kThreads);
constexpr int kGroup = 8;                   // entries blended before their rows are summed: with 4 rows, 32 lanes
constexpr int kQueue = kGroup + kWarpSize;  // at most 7 remaining and 32 new ones
static_assert(kQueue % kGroup == 0, "a group never wraps around the end of the ring");
constexpr int kRowPixels = kSubTileWidth;  // 8
constexpr int kRowsAtOnce = kWarpSize / kRowPixels;

// A patch. Lane l has the pixels (l % 8, l / 8 + 4 k), k < kLanePixels.
constexpr int kLanePixels = kCudaTilePixels / kThreads, kPatchWidth = kRowPixels,
              kPatchHeight = kRowsAtOnce * kLanePixels;
/// Distance between the pixel values of two entries in shared memory. It is 4 more than the number of pixels, so that 8
/// lanes read rows from different banks.
constexpr int kStride = kPatchWidth * kPatchHeight + 4;

/// The part of the bucket's splats that blending reads.
template <bool kWithDepth>
struct BucketSplats {
  static constexpr int kNothing = kBucketEntries;  // index of a splat that contributes nowhere
  float4 mean_conic[kNothing + 1];                 // mean_x, mean_y, conic_xx, conic_yy
  float4 rest[kNothing + 1];                       // conic_xy, log2_opacity, red, green
  float blue[kNothing + 1];
  float depth[kWithDepth ? kNothing + 1 : 1];
  float2 extent[kBucketEntries];

  __device__ __forceinline__ void set_nothing() {
    mean_conic[kNothing] = make_float4(0, 0, 0, 0);
    rest[kNothing] = make_float4(0, 2 * kLog2AlphaMin, 0, 0);
    blue[kNothing] = 0;
    if constexpr (kWithDepth) depth[kNothing] = 0;
  }
};

/// A splat on its way to BucketSplats. All loads are issued before the first value is used.
struct LoadedSplat {
  float4 mean{}, conic{}, color{};
  float2 extent{};
  __device__ __forceinline__ LoadedSplat(const BlendBackwardArgs& blend, std::int32_t id) {
    if (id < 0) return;
    mean = load_mean(blend.splats, id), conic = load_conic(blend.splats, id);
    color = load_color(blend.splats, id);
    extent = __ldg(reinterpret_cast<const float2*>(blend.extents) + id);
  }
  template <bool kWithDepth>
  __device__ __forceinline__ void store(BucketSplats<kWithDepth>& splats, int at) const {
    splats.mean_conic[at] = make_float4(mean.x, mean.y, conic.x, conic.z);
    splats.rest[at] = make_float4(conic.y, mean.z, color.x, color.y);
    splats.blue[at] = color.z;
    if constexpr (kWithDepth) splats.depth[at] = mean.w;
    splats.extent[at] = extent;
  }
};

/// A warp's shared memory.
template <bool kWithDepth>
struct PatchMemory {
  static constexpr int kSums = kWithDepth ? 11 : 9;  // odd, so that lanes access different banks
  alignas(8) std::uint8_t queue[kQueue];             // ring buffer of indices in BucketSplats
  // Pixel values of the group.
  alignas(16) float weight[kGroup * kStride];
  alignas(16) float log_alpha[kGroup * kStride];
  // Results for each queued entry.
  unsigned queued[kBucketEntries / kWarpSize];  // a bit per entry
  float sums[kBucketEntries * kSums];
};

/// The bucket of a block.
struct BucketRange {
  std::int32_t tile;
  std::int64_t first;           // first pair of the tile's list
  std::int32_t begin, end;      // entries of the bucket, as positions in the list
  bool is_summed;               // state_behind()
  std::int32_t tile_x, tile_y;  // upper left corner of the tile, px
  __device__ BucketRange(const BlendBackwardCudaArgs& args, std::int64_t bucket)
      : tile(args.buckets.tile_of_bucket[bucket]), first(args.blend.bins.tile_offsets[tile]) {
    const TileGrid& grid = args.blend.grid;
    begin = static_cast<std::int32_t>(bucket - args.buckets.offsets[tile]) * kBucketEntries;
    const std::int32_t length = list_length(args.blend.bins, tile);
    end = min(begin + kBucketEntries, length);
    is_summed = args.behind != nullptr && length >= kShortListEntries;
    tile_x = tile % grid.columns * kCudaTileSide;
    tile_y = tile / grid.columns * kCudaTileSide;
  }
};

/// One warp: a patch and the entries of the bucket that reach it.
template <bool kWithDepth>
class PatchBlend {
 public:
  using Memory = PatchMemory<kWithDepth>;
  using Splats = BucketSplats<kWithDepth>;

  __device__ __forceinline__ PatchBlend(const BlendBackwardCudaArgs& args, const BucketRange& range,
                                        const Splats& splats, Memory& memory, int patch)
      : args_(args), blend_(args.blend), range_(range), splats_(splats), memory_(memory) {
    const TilePixel at = first_pixel(patch);
    center_x_ = at.center_x(), center_y_ = at.center_y();
#pragma unroll
    for (int k = 0; k < kLanePixels; ++k) {
      last_[k] = at.x < blend_.grid.image_width && at.y + kRowsAtOnce * k < blend_.grid.image_height
                     ? blend_.last_ids[pixel_at(at, k)]
                     : -1;
    }
  }

  /// Returns the position in the list of the last splat of this lane's pixels, or -1.
  __device__ __forceinline__ std::int32_t last() const {
    std::int32_t last = last_[0];
#pragma unroll
    for (int k = 1; k < kLanePixels; ++k) last = max(last, last_[k]);
    return last;
  }

  /// Loads the pixels' gradients and their states behind the bucket.
  __device__ __forceinline__ void load_pixels(int patch) {
    const TilePixel at = first_pixel(patch);  // not a member, because it would occupy registers until the end
#pragma unroll
    for (int k = 0; k < kLanePixels; ++k) {
      if (last_[k] >= range_.begin) {
        const std::int64_t pixel = pixel_at(at, k);
        grad_[k] = load_pixel_grad(blend_, pixel);
        state_[k] = {blend_.transmittance[pixel], loss_behind_list(blend_, pixel, grad_[k])};
      }
      if (last_[k] >= range_.end) {
        state_[k] =
            state_behind<kWithDepth>(args_, range_.is_summed, range_.tile, range_.begin / kBucketEntries,
                                     at.index + kRowsAtOnce * kCudaTileSide * k, last_[k], grad_[k], state_[k].behind);
      }
#pragma unroll
      for (int i = 0; i < kRowPixels; ++i) {
        const int lane = lane_ % kRowsAtOnce * kRowPixels + i;
        row_grad_[k][i] = {
            {__shfl_sync(kFullWarp, grad_[k].color.x, lane), __shfl_sync(kFullWarp, grad_[k].color.y, lane),
             __shfl_sync(kFullWarp, grad_[k].color.z, lane)},
            kWithDepth ? __shfl_sync(kFullWarp, grad_[k].depth, lane) : 0.0f};
      }
    }
  }

  /// Processes all entries of the bucket, from the last to the first.
  __device__ __forceinline__ void run() {
    if (lane_ < kBucketEntries / kWarpSize) memory_.queued[lane_] = 0;
    __syncwarp();
    for (std::int32_t first = min(range_.end - 1, warp_max(last())); first >= range_.begin; first -= kWarpSize) {
      gather(first - lane_);
      for (; n_queued_ >= kGroup; n_queued_ -= kGroup) blend_group(kGroup);
    }
    if (n_queued_ > 0) {
      if (lane_ >= n_queued_ && lane_ < kGroup) memory_.queue[head_ + lane_] = Splats::kNothing;
      __syncwarp();
      blend_group(n_queued_);
    }
  }

  /// Returns the middle of a patch, px.
  __device__ static __forceinline__ float2 center(const BucketRange& range, int patch) {
    return make_float2(static_cast<float>(range.tile_x) + (static_cast<float>(patch % 2) + 0.5f) * kPatchWidth,
                       static_cast<float>(range.tile_y) + (static_cast<float>(patch / 2) + 0.5f) * kPatchHeight);
  }

 private:
  /// Returns the first of this lane's pixels.
  __device__ __forceinline__ TilePixel first_pixel(int patch) const {
    const int x = patch % 2 * kPatchWidth + lane_ % kRowPixels, y = patch / 2 * kPatchHeight + lane_ / kRowPixels;
    const std::int32_t image_x = range_.tile_x + x, image_y = range_.tile_y + y;
    return {image_x, image_y, y * kCudaTileSide + x,
            image_x < blend_.grid.image_width && image_y < blend_.grid.image_height};
  }
  /// Returns the index in the image of pixel `k` of this lane. `at` is the first one.
  __device__ __forceinline__ std::int64_t pixel_at(const TilePixel& at, int k) const {
    return static_cast<std::int64_t>(at.y + kRowsAtOnce * k) * blend_.grid.image_width + at.x;
  }

  /// Appends the entries that reach the patch to the queue. Each lane tests the entry at list position `position`, in
  /// the order of the queue.
  __device__ __forceinline__ void gather(std::int32_t position) {
    const std::int32_t entry = position - range_.begin;
    bool reaches = false;
    if (entry >= 0) {
      const float4 mean = splats_.mean_conic[entry];
      const float2 extent = splats_.extent[entry];
      const float left = center_x_ - static_cast<float>(lane_ % kRowPixels);
      const float top = center_y_ - static_cast<float>(lane_ / kRowPixels);
      reaches = mean.x + extent.x >= left && mean.x - extent.x <= left + (kPatchWidth - 1) &&
                mean.y + extent.y >= top && mean.y - extent.y <= top + (kPatchHeight - 1);
    }
    const unsigned reaching = __ballot_sync(kFullWarp, reaches);
    const unsigned before = reaching & ((1u << lane_) - 1);
    if (reaches) memory_.queue[wrapped(head_ + n_queued_ + __popc(before))] = static_cast<std::uint8_t>(entry);
#pragma unroll
    for (int k = 0; k < kLanePixels; ++k) {
      // The entry of lane l is at first - l, so the first lanes' entries are behind the pixel's last splat.
      const int n_behind = position + lane_ - last_[k];
      skip_[k] += __popc(n_behind >= kWarpSize ? reaching : n_behind > 0 ? reaching & ((1u << n_behind) - 1) : 0u);
    }
    n_queued_ += __popc(reaching);
    __syncwarp();  // the queue is visible to all lanes
  }

  struct QueuedSplat {
    float4 mean_conic, rest;
    float blue, depth;
  };
  __device__ __forceinline__ QueuedSplat load(unsigned at) const {
    return {splats_.mean_conic[at], splats_.rest[at], splats_.blue[at], kWithDepth ? splats_.depth[at] : 0.0f};
  }

  /// Blends the first kGroup entries of the queue and stores their sums. Only the first `count` entries are real.
  __device__ __forceinline__ void blend_group(int count) {
    static_assert(kGroup == 8, "one load of 8 bytes");
    const uint2 group = *reinterpret_cast<const uint2*>(memory_.queue + head_);
    QueuedSplat next = load(group.x & 0xffu);
#pragma unroll
    for (int slot = 0; slot < kGroup; ++slot) {
      // Load each splat before the previous one stores its values, because a load cannot be moved across those stores.
      const float4 mean_conic = next.mean_conic, rest = next.rest;
      const float blue = next.blue, depth = next.depth;
      const int following = (slot + 1) % kGroup;
      next = load((following < 4 ? group.x : group.y) >> 8 * (following % 4) & 0xffu);
      const SplatShape<float> shape{mean_conic.x, mean_conic.y, rest.y, mean_conic.z, rest.x, mean_conic.w};
#pragma unroll
      for (int k = 0; k < kLanePixels; ++k) {
        const Footprint<float> footprint =
            evaluate_footprint(shape, center_x_, center_y_ + static_cast<float>(kRowsAtOnce * k));
        float value = grad_[k].color.x * rest.z + grad_[k].color.y * rest.w + grad_[k].color.z * blue;
        if constexpr (kWithDepth) value += grad_[k].depth * depth;
        const BlendGrad<float> grad = blend_over_reverse(state_[k], footprint.contributes && slot >= skip_[k],
                                                         evaluate_alpha(footprint.power), value);
        memory_.weight[slot * kStride + kWarpSize * k + lane_] = grad.weight;
        memory_.log_alpha[slot * kStride + kWarpSize * k + lane_] = grad.log_alpha;
      }
    }
    __syncwarp();  // the pixel values are visible to all lanes
    const bool is_real = lane_ / kRowsAtOnce < count;
    store_sums(memory_.queue[head_ + (is_real ? lane_ / kRowsAtOnce : 0)], is_real);
    head_ = wrapped(head_ + kGroup);
#pragma unroll
    for (int k = 0; k < kLanePixels; ++k) skip_[k] = max(skip_[k] - kGroup, 0);
    __syncwarp();  // all lanes have read the data that the next group overwrites
  }

  /// Sums the rows of the group. Lane l has row l % 4 (and l % 4 + 4) of entry l / 4 of the group. `entry` is the index
  /// of that entry in the bucket.
  __device__ __forceinline__ void store_sums(std::int32_t entry, bool is_real) {
    const int slot = lane_ / kRowsAtOnce, row = lane_ % kRowsAtOnce;
    float sum[10] = {};
#pragma unroll
    for (int k = 0; k < kLanePixels; ++k) {
      const int at = slot * kStride + kWarpSize * k + row * kRowPixels;
      float w[kRowPixels], q[kRowPixels];
#pragma unroll
      for (int i = 0; i < kRowPixels; i += 4) {
        *reinterpret_cast<float4*>(w + i) = *reinterpret_cast<const float4*>(memory_.weight + at + i);
        *reinterpret_cast<float4*>(q + i) = *reinterpret_cast<const float4*>(memory_.log_alpha + at + i);
      }
      float row_q = 0, row_qu = 0;
#pragma unroll
      for (int i = 0; i < kRowPixels; ++i) {
        const float u = static_cast<float>(i) - 0.5f * (kPatchWidth - 1);
        row_q += q[i];
        row_qu += q[i] * u;
        sum[kQuu] += q[i] * (u * u);
        sum[kRed] += w[i] * row_grad_[k][i].color.x;
        sum[kGreen] += w[i] * row_grad_[k][i].color.y;
        sum[kBlue] += w[i] * row_grad_[k][i].color.z;
        if constexpr (kWithDepth) sum[kDepth] += w[i] * row_grad_[k][i].depth;
      }
      const float v = static_cast<float>(row + kRowsAtOnce * k) - 0.5f * (kPatchHeight - 1);
      sum[kQ] += row_q;
      sum[kQu] += row_qu;
      sum[kQv] += row_q * v;
      sum[kQuv] += row_qu * v;
      sum[kQvv] += row_q * (v * v);
    }
    // Sum over the four lanes of an entry. Lanes exchange halves, so that each ends with two of the first eight sums.
    const bool upper = (lane_ & 2) != 0, odd = (lane_ & 1) != 0;
    const auto exchange = [](float low, float high, bool keep_high, int distance) {
      return (keep_high ? high : low) + __shfl_xor_sync(kFullWarp, keep_high ? low : high, distance);
    };
    float half[4];
#pragma unroll
    for (int i = 0; i < 4; ++i) half[i] = exchange(sum[i], sum[i + 4], upper, 2);
    const float first = exchange(half[0], half[2], odd, 1), second = exchange(half[1], half[3], odd, 1);
#pragma unroll
    for (int i = kQuv; i < (kWithDepth ? 10 : 9); ++i) {
      sum[i] += __shfl_xor_sync(kFullWarp, sum[i], 2);
      sum[i] += __shfl_xor_sync(kFullWarp, sum[i], 1);
    }
    if (!is_real) return;
    float* const out = memory_.sums + entry * Memory::kSums;
    const int own = (upper ? 4 : 0) + (odd ? 2 : 0);
    out[own] = first;
    out[own + 1] = second;
    if (row == 0) {
      out[kQuv] = sum[kQuv];
      if constexpr (kWithDepth) out[kDepth] = sum[kDepth];
      atomicOr(&memory_.queued[entry / kWarpSize], 1u << (entry % kWarpSize));
    }
  }

  __device__ static __forceinline__ int wrapped(int index) {
    return index < kQueue ? index : index - kQueue;
  }

  const BlendBackwardCudaArgs& args_;
  const BlendBackwardArgs& blend_;
  const BucketRange& range_;
  const Splats& splats_;
  Memory& memory_;
  const int lane_ = lane_id();
  // Pixels of this lane.
  float center_x_, center_y_;  // of the first pixel
  std::int32_t last_[kLanePixels];
  PixelGrad grad_[kLanePixels]{};
  ReverseState<float> state_[kLanePixels]{};
  int skip_[kLanePixels]{};  // queued entries behind the last splat of the pixel
  // Rows that this lane sums.
  PixelGrad row_grad_[kLanePixels][kRowPixels];
  // The queue.
  int head_ = 0, n_queued_ = 0;
};

/// Adds the sums of this thread's entry to memory.
template <bool kWithDepth, class Splats, class Memory>
__device__ __forceinline__ void add_entry(const BlendBackwardCudaArgs& args, const BucketRange& range,
                                          const Splats& splats, const Memory* memory) {
  const auto entry = static_cast<std::int32_t>(threadIdx.x);
  const std::int64_t pair = range.first + range.begin + entry;
  if (range.begin + entry >= range.end) return;
  const std::int32_t id = args.blend.bins.splat_ids[pair];
  const float4 mean = splats.mean_conic[entry];
  const FactoredConic factors(make_float4(mean.z, splats.rest[entry].x, mean.w, 0));
  FactoredSums total;
  bool is_reached = false;
#pragma unroll
  for (int patch = 0; patch < kWarps; ++patch) {
    if ((memory[patch].queued[entry / kWarpSize] >> (entry % kWarpSize) & 1) == 0) continue;
    is_reached = true;
    const float* const sums = memory[patch].sums + entry * Memory::kSums;
    add_patch(total, sums, PatchBlend<kWithDepth>::center(range, patch), mean, factors);
    if constexpr (kWithDepth) total.depth += sums[kDepth];
  }
  if (!is_reached) return;
  const SplatGrad grad = splat_grad(total, factors);
  if (args.pair_grads != nullptr) {
    args.pair_grads[args.blend.bins.pair_slots[pair]] = {grad, {0, 0}};
  } else {
    atomic_add<kWithDepth>(args.splat_grads + id, grad);
  }
}

constexpr int kResidentBlocks = 4;  // per multiprocessor (H100), as many as registers allow

template <bool kWithDepth>
__global__ void __launch_bounds__(kThreads, kResidentBlocks)
    backward_per_bucket_kernel(const BlendBackwardCudaArgs args) {
  using Patch = PatchBlend<kWithDepth>;
  __shared__ typename Patch::Memory memory[kWarps];
  __shared__ typename Patch::Splats splats;
  const auto bucket = static_cast<std::int64_t>(blockIdx.x);
  const BucketRange range(args, bucket);
  const int patch = static_cast<int>(threadIdx.x) / kWarpSize;
  const auto entry = static_cast<std::int32_t>(threadIdx.x);
  const std::int32_t id =
      range.begin + entry < range.end ? __ldg(args.blend.bins.splat_ids + range.first + range.begin + entry) : -1;
  Patch blend(args, range, splats, memory[patch], patch);
  if (__syncthreads_or(blend.last() >= range.begin) == 0) return;  // all pixels finish in front of the bucket
  const LoadedSplat splat(args.blend, id);
  blend.load_pixels(patch);
  splat.store(splats, entry);
  if (entry == 0) splats.set_nothing();
  __syncthreads();  // the bucket's splats are loaded
  blend.run();
  __syncthreads();  // the sums of all patches are stored
  add_entry<kWithDepth>(args, range, splats, memory);
}

}  // namespace

void launch_backward_per_bucket(const BlendBackwardCudaArgs& args, const LaunchContext& context) {
  const auto launch = [&](auto with_depth) {
    if (args.behind != nullptr) {
      launch_blocks(sum_behind_kernel<with_depth.value>, args.n_long_lists * kSumBlocks, kSumThreads, context, args);
    }
    launch_blocks(backward_per_bucket_kernel<with_depth.value>, args.buckets.n, kThreads, context, args);
  };
  if (args.blend.grad.depth != nullptr) {
    launch(std::true_type());
  } else {
    launch(std::false_type());
  }
}

}  // namespace b3dgs::cuda
