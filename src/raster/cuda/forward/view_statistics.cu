// What a rendered view says about its load and its Gaussians.
//
// Load counting, count_load. Grid: a block per tile; thread: one pixel; lists are read from global memory without
// staging. Training calls it only for its statistics, so it does not have to be fast.
//
// Scoring, kernel 1, score: sums for each splat.
//   Grid: a block per tile, assigned statically. Warp: a sub-tile of 8 x 4 pixels. Thread: one pixel.
//   Stage: each thread loads one splat of the batch to shared memory, and zeroes its sums there.
//   Cull: for every 32 staged splats a warp tests, a lane per splat, whose bounding box reaches the sub-tile.
//   Score: a warp takes the remaining splats in order. It adds its 32 pixels' weights with integer reductions, and one
//     lane adds the sums to those of the block. A warp stops once all of its pixels are finished.
//   Barriers: two per batch. After the first, each thread adds the block's sums of its splat to memory: an integer
//     atomic per sum, tile and splat. Integers add up to the same sum in any order.
//
// Scoring, kernel 2, add_scores: a thread per splat adds its sums to its Gaussian's.

#include "core/cuda_rows.cuh"
#include "raster/cuda/forward/tile_blend.cuh"
#include "raster/cuda/launch.cuh"
#include "raster/math/pixel_load.h"
#include "raster/math/pixel_outputs.h"

namespace b3dgs::cuda {
namespace {

constexpr int kAddThreads = 256;

template <int kThreads>
__global__ void __launch_bounds__(kThreads) count_load_kernel(const CountLoadArgs args) {
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

/// A batch of splats in shared memory, one per thread of the block, and what the block's pixels add up for them.
template <int kThreads>
struct ScoredBatch {
  static_assert(std::uint64_t{kThreads} * kScoreMax < std::uint64_t{1} << 32, "a tile's sums fit into 32 bits");
  float4 mean[kThreads];
  float4 conic[kThreads];
  float2 extent[kThreads];
  unsigned error[kThreads], weight[kThreads];
  int max_weight[kThreads];  // bits of a float, which compare like it: weights are not negative

  __device__ __forceinline__ void stage(const ScoreArgs& args, std::int32_t id) {
    mean[threadIdx.x] = load_mean(args.splats, id).v;
    conic[threadIdx.x] = load_conic(args.splats, id).v;
    extent[threadIdx.x] = __ldg(reinterpret_cast<const float2*>(args.extents) + id);
    error[threadIdx.x] = weight[threadIdx.x] = 0;
    max_weight[threadIdx.x] = 0;
  }
  __device__ __forceinline__ void add_to(ScoreSums* sums) const {
    if (max_weight[threadIdx.x] == 0) return;  // not blended
    atomicAdd(reinterpret_cast<unsigned long long*>(&sums->error), static_cast<unsigned long long>(error[threadIdx.x]));
    atomicAdd(reinterpret_cast<unsigned long long*>(&sums->weight),
              static_cast<unsigned long long>(weight[threadIdx.x]));
    atomicMax(reinterpret_cast<int*>(&sums->max_weight), max_weight[threadIdx.x]);
  }
};

template <int kThreads>
__global__ void __launch_bounds__(kThreads) score_kernel(const ScoreArgs args) {
  __shared__ ScoredBatch<kThreads> batch;
  const auto tile = static_cast<std::int32_t>(blockIdx.x);
  const TilePixel at = tile_pixel(args.grid, tile, sub_tile_pixel(static_cast<std::int32_t>(threadIdx.x)));
  const float center_x = at.center_x(), center_y = at.center_y();
  const float left = __shfl_sync(kFullWarp, center_x, 0), top = __shfl_sync(kFullWarp, center_y, 0);
  const float error =
      at.inside ? clamp_error(args.error[static_cast<std::int64_t>(at.y) * args.grid.image_width + at.x]) : 0.0f;
  const std::int64_t first = args.bins.tile_offsets[tile], last = args.bins.tile_offsets[tile + 1];

  float transmittance = at.inside ? 1.0f : kClosedPixel;
  std::int32_t staged_id = -1;  // splat that this thread has staged
  for (std::int64_t start = first;; start += kThreads) {
    // All threads have finished with the previous batch.
    const bool is_done = __syncthreads_count(is_finished(transmittance)) == kThreads;
    if (staged_id >= 0) batch.add_to(args.sums + staged_id);
    if (is_done || start >= last) break;
    staged_id = start + threadIdx.x < last ? args.bins.splat_ids[start + threadIdx.x] : -1;
    if (staged_id >= 0) batch.stage(args, staged_id);
    __syncthreads();  // the batch is complete

    const int count = static_cast<int>(last - start < kThreads ? last - start : kThreads);
    for (int run = 0; run < count; run += kWarpSize) {
      if (!__any_sync(kFullWarp, is_open(transmittance))) break;
      const int tested = run + lane_id();
      const bool reaches = tested < count && reaches_sub_tile(batch.mean[tested].x, batch.mean[tested].y,
                                                              batch.extent[tested], left, top);
      for (unsigned chosen = __ballot_sync(kFullWarp, reaches); chosen != 0; chosen &= chosen - 1) {
        const int j = run + __ffs(static_cast<int>(chosen)) - 1;
        const SplatShape<float> shape = make_splat_shape({batch.mean[j]}, {batch.conic[j]});
        const Footprint<float> footprint = evaluate_footprint(shape, center_x, center_y);
        const float weight =
            blend_weight_over(transmittance, footprint.contributes, evaluate_alpha(footprint.power).alpha);
        if (!__any_sync(kFullWarp, weight > 0)) continue;
        const unsigned weights = warp_sum(score_units(weight)), errors = warp_sum(score_units(weight * error));
        const int max_weight = warp_max(__float_as_int(weight));
        if (lane_id() == 0) {
          atomicAdd(batch.weight + j, weights);
          atomicAdd(batch.error + j, errors);
          atomicMax(batch.max_weight + j, max_weight);
        }
      }
    }
  }
}

__global__ void __launch_bounds__(kAddThreads) add_scores_kernel(const AddScoresArgs args) {
  const std::int64_t m = own_row<kAddThreads>();
  if (m < args.n_splats) b3dgs::add_scores(args.sums[m], args.out, args.splats[m].gaussian);
}

}  // namespace

void count_load(const CountLoadArgs& args, const LaunchContext& context) {
  with_tile_pixels(args.grid.tile, [&](auto pixels) {
    count_load_kernel<pixels.value><<<args.grid.n_tiles(), pixels.value, 0, context.stream>>>(args);
  });
  B3DGS_CUDA_CHECK_LAUNCH();
}

void score(const ScoreArgs& args, const LaunchContext& context) {
  with_tile_pixels(args.grid.tile, [&](auto pixels) {
    score_kernel<pixels.value><<<args.grid.n_tiles(), pixels.value, 0, context.stream>>>(args);
  });
  B3DGS_CUDA_CHECK_LAUNCH();
}

void add_scores(const AddScoresArgs& args, const LaunchContext& context) {
  launch_rows<kAddThreads>(add_scores_kernel, args, args.n_splats, context.stream);
}

}  // namespace b3dgs::cuda
