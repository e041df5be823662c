// Statistics of a rendered view: its load, and scores of its Gaussians.
//
// Both work on the tiles of either family. A block has as many threads as a tile has pixels, 256 or 128.
//
// Load counting, count_load. Grid: a block per tile. Thread: one pixel. Lists are read from global memory without
// staging. Training calls it only for its statistics, so it does not have to be fast.
//
// Scoring, kernel 1, score: sums for each splat.
//   Grid: a block per tile, longest list first. Warp: a sub-tile of 8 x 4 pixels. Thread: one pixel.
//   Stage and cull: as in staged_blend.cuh. Each thread also zeroes the sums of the splat that it stages.
//   Score: a warp takes the remaining splats in order, evaluates four at once, and adds the weights of its 32 pixels
//     with integer reductions. Each lane keeps the sums of one of 32 splats and then adds them to those of the block. A
//     warp stops once all its pixels are finished.
//   Barriers: one per batch. After it, each thread adds the block's sums of the splat that it staged before to memory,
//     with an integer atomic per sum, tile and splat. Integer sums do not depend on the order.
//
// Scoring, kernel 2, add_scores: a thread per splat adds its sums to those of its Gaussian.

#include <cuda_pipeline.h>

#include "raster/cuda/forward/tile_blend.cuh"
#include "raster/cuda/launch.cuh"
#include "raster/math/blend.h"
#include "raster/math/pixel_outputs.h"

namespace b3dgs::cuda {
namespace {

constexpr int kMostThreads = kCudaTilePixels;

int tile_threads(const TileGrid& grid) {
  return grid.tile.width * grid.tile.height;
}

__global__ void __launch_bounds__(kMostThreads) count_load_kernel(const CountLoadArgs args) {
  const auto tile = static_cast<std::int32_t>(blockIdx.x);
  const TilePixel at = tile_pixel(args.grid, tile, static_cast<std::int32_t>(threadIdx.x));
  if (!at.inside) return;
  PixelLoad load;
  const std::int64_t last = args.bins.tile_offsets[tile + 1];
  for (std::int64_t i = args.bins.tile_offsets[tile]; i < last; ++i) {
    const std::int32_t id = args.bins.splat_ids[i];
    const SplatShape<float> shape = make_splat_shape(load_mean(args.splats, id), load_conic(args.splats, id));
    if (!count_entry(load, shape, at.center_x(), at.center_y())) break;
  }
  const std::int64_t pixel = static_cast<std::int64_t>(at.y) * args.grid.image_width + at.x;
  args.processed[pixel] = load.processed;
  args.contributing[pixel] = load.contributing;
}

/// A batch of splats in shared memory, one per thread of the block, and the sums of the block's pixels for them.
struct ScoredBatch {
  static_assert(std::uint64_t{kMostThreads} * kScoreMax < std::uint64_t{1} << 32, "a tile's sums fit into 32 bits");
  float4 mean[kMostThreads];
  float4 conic[kMostThreads];
  float2 extent[kMostThreads];
  unsigned error[kMostThreads], weight[kMostThreads];
  int max_weight[kMostThreads];  // bits of a float, which compare like it because weights are not negative

  /// Starts copying a splat to the entry of this thread.
  __device__ __forceinline__ void copy(const ScoreArgs& args, std::int32_t id) {
    const auto* const words = reinterpret_cast<const float4*>(args.splats + id);
    __pipeline_memcpy_async(mean + threadIdx.x, words, sizeof(float4));
    __pipeline_memcpy_async(conic + threadIdx.x, words + 1, sizeof(float4));
    __pipeline_memcpy_async(extent + threadIdx.x, args.extents + id, sizeof(float2));
    error[threadIdx.x] = weight[threadIdx.x] = 0;
    max_weight[threadIdx.x] = 0;
  }
  __device__ __forceinline__ void add_to(ScoreSums* sums) const {
    if (max_weight[threadIdx.x] == 0) return;  // not blended
    atomicAdd(reinterpret_cast<unsigned long long*>(&sums->error), static_cast<unsigned long long>(error[threadIdx.x]));
    if (weight[threadIdx.x] > 0) {
      atomicAdd(reinterpret_cast<unsigned long long*>(&sums->weight),
                static_cast<unsigned long long>(weight[threadIdx.x]));
    }
    atomicMax(reinterpret_cast<int*>(&sums->max_weight), max_weight[threadIdx.x]);
  }

  /// Scores the splats from `first` on whose bit in `chosen` (32 bits) is set, in order.
  __device__ __forceinline__ void score(int first, unsigned chosen, float center_x, float center_y, float pixel_error,
                                        bool wants_weights, float& transmittance) {
    constexpr int kAtOnce = 4;  // independent evaluations that hide the latency of shared memory and the exponential
    unsigned own_error = 0, own_weight = 0;  // of splat `first` + lane
    int own_largest = 0;
    while (chosen != 0) {
      int indices[kAtOnce];
      bool contributes[kAtOnce];
      float alpha[kAtOnce];
#pragma unroll
      for (int k = 0; k < kAtOnce; ++k) {
        const bool is_chosen = chosen != 0;
        indices[k] = is_chosen ? first + __ffs(static_cast<int>(chosen)) - 1 : first;
        chosen &= chosen - 1;
        const SplatShape<float> shape = make_splat_shape(mean[indices[k]], conic[indices[k]]);
        const Footprint<float> footprint = evaluate_footprint(shape, center_x, center_y);
        contributes[k] = footprint.contributes && is_chosen;
        alpha[k] = evaluate_alpha(footprint.power).alpha;
      }
#pragma unroll
      for (int k = 0; k < kAtOnce; ++k) {
        const float value = blend_weight_over(transmittance, contributes[k], alpha[k]);
        const int largest = warp_max(__float_as_int(value));
        if (largest == 0) continue;
        const unsigned errors = warp_sum(score_units(value * value * pixel_error));
        const unsigned weights = wants_weights ? warp_sum(score_units(value)) : 0;
        if (first + lane_id() == indices[k]) own_error = errors, own_weight = weights, own_largest = largest;
      }
    }
    if (own_largest == 0) return;
    atomicAdd(error + first + lane_id(), own_error);
    if (wants_weights) atomicAdd(weight + first + lane_id(), own_weight);
    atomicMax(max_weight + first + lane_id(), own_largest);
  }
};

__global__ void __launch_bounds__(kMostThreads)
    score_kernel(const ScoreArgs args, const std::int32_t* __restrict__ tiles_by_length, bool wants_weights) {
  __shared__ ScoredBatch batches[2];  // one is scored while the other is loaded
  const std::int32_t tile = tiles_by_length[blockIdx.x];
  const auto thread = static_cast<std::int32_t>(threadIdx.x), n_threads = static_cast<std::int32_t>(blockDim.x);
  const TilePixel at = tile_pixel(args.grid, tile, sub_tile_pixel(thread));
  const float center_x = at.center_x(), center_y = at.center_y();
  const float left = __shfl_sync(kFullWarp, center_x, 0), top = __shfl_sync(kFullWarp, center_y, 0);
  const float error =
      at.inside ? clamp_error(args.error[static_cast<std::int64_t>(at.y) * args.grid.image_width + at.x]) : 0.0f;
  const std::int32_t* const ids = args.bins.splat_ids + args.bins.tile_offsets[tile];
  const std::int32_t n = list_length(args.bins, tile);

  float transmittance = at.inside ? 1.0f : kClosedPixel;
  // Splats staged by this thread: of the previous batch, of this batch, and the next one to stage.
  std::int32_t before = -1, here = -1, next = thread < n ? ids[thread] : -1;
  int turn = 1;
  for (std::int32_t start = -n_threads;; start += n_threads, turn ^= 1) {
    ScoredBatch &batch = batches[turn], &other = batches[turn ^ 1];
    __pipeline_wait_prior(0);
    // The one barrier per batch. This batch is complete, and all threads have finished with the previous one.
    const bool is_done = __syncthreads_and(is_finished(transmittance)) || start >= n;
    if (before >= 0) other.add_to(args.sums + before);
    if (is_done) break;
    if (next >= 0) other.copy(args, next);
    __pipeline_commit();
    before = here;
    here = next;
    const std::int32_t ahead = start + 2 * n_threads + thread;
    next = ahead < n ? ids[ahead] : -1;

    const int count = start < 0 ? 0 : min(n - start, n_threads);
    for (int run = 0; run < count; run += kWarpSize) {
      if (!__any_sync(kFullWarp, is_open(transmittance))) break;
      const int tested = run + lane_id();
      const bool reaches = tested < count && reaches_sub_tile(batch.mean[tested].x, batch.mean[tested].y,
                                                              batch.extent[tested], left, top);
      batch.score(run, __ballot_sync(kFullWarp, reaches), center_x, center_y, error, wants_weights, transmittance);
    }
  }
}

}  // namespace

void count_load(const CountLoadArgs& args, const LaunchContext& context) {
  launch_blocks(count_load_kernel, args.grid.n_tiles(), tile_threads(args.grid), context, args);
}

void score(const ScoreArgs& args, const std::int32_t* tiles_by_length, bool wants_weights,
           const LaunchContext& context) {
  launch_blocks(score_kernel, args.grid.n_tiles(), tile_threads(args.grid), context, args, tiles_by_length,
                wants_weights);
}

void add_scores(const AddScoresArgs& args, const std::int32_t* radii, const LaunchContext& context) {
  each_row(args.n_splats, context, [=] __device__(std::int64_t m) {
    if (radii == nullptr || radii[m] > 0) b3dgs::add_scores(args.sums[m], args.out, args.splats[m].gaussian);
  });
}

}  // namespace b3dgs::cuda
