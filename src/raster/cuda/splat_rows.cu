// Views split at the splats (splat_rows.h). Rows are splats in the order of their Gaussians; a splat's place in the
// order of depth is its rank.
//   copy_seen_kernel: after projection; a thread per row copies it from the Gaussian's.
//   load_rows_kernel: in place of projection; a thread per row copies it and counts its tiles.
//   rows_of_ranks_kernel: after the backward blend or scoring; a thread per 8-byte word copies it from the splat's
//   rank. Shared memory: in load_rows_kernel, the block's numbers of splats and pairs. Barriers: two, around these
//   sums.

#include <cstdint>

#include "raster/cuda/count_view.cuh"
#include "raster/math/tiling.h"

namespace b3dgs::cuda {
namespace {

constexpr int kThreads = 256;

unsigned blocks_for(std::int64_t n) {
  return static_cast<unsigned>((n + kThreads - 1) / kThreads);
}

__device__ __forceinline__ std::int64_t thread_index() {
  return static_cast<std::int64_t>(blockIdx.x) * kThreads + threadIdx.x;
}

__global__ void __launch_bounds__(kThreads) copy_seen_kernel(const CopySeenArgs args) {
  const std::int64_t m = thread_index();
  if (m >= args.n_splats || (args.counts != nullptr && m >= args.counts->n_splats)) return;
  const std::int32_t i = args.seen[m];
  args.out.splats[m] = args.projected.splats[i];
  args.out.extents[m] = args.projected.extents[i];
  args.out.radii[m] = args.projected.radii[i];
}

__global__ void __launch_bounds__(kThreads) load_rows_kernel(const LoadRowsArgs args) {
  __shared__ unsigned long long block_splats, block_pairs;
  if (threadIdx.x == 0) block_splats = block_pairs = 0;
  __syncthreads();

  const std::int64_t m = thread_index();
  std::int32_t n_tiles = 0;
  if (m < args.rows.n_splats) {
    Splat splat = args.rows.splats[m];
    splat.gaussian = static_cast<std::int32_t>(m);
    const Vec2f extent = args.rows.extents[m];
    const std::int32_t radius = args.rows.radii[m];
    n_tiles = tiles_touched(args.grid, args.culling, splat, extent, radius);
    args.out.splats[m] = splat;
    args.out.extents[m] = extent;
    args.out.radii[m] = n_tiles > 0 ? radius : 0;
    args.out.n_tiles[m] = n_tiles;
    args.out.depth_bits[m] = n_tiles > 0 ? __float_as_uint(splat.depth) : 0;
  }
  count_splat(n_tiles, block_splats, block_pairs, args.out.counts);
}

/// Rows of `words` words each; 0 for a row that is not drawn.
__global__ void __launch_bounds__(kThreads)
    rows_of_ranks_kernel(const RanksOfRows ranks, int words, const unsigned long long* by_rank,
                         unsigned long long* by_row) {
  const std::int64_t k = thread_index();
  const std::int64_t row = k / words;
  if (row >= ranks.n_rows) return;
  const bool is_drawn = ranks.radii[row] > 0;
  by_row[k] = is_drawn ? by_rank[std::int64_t{ranks.rank_of_row[row]} * words + k % words] : 0;
}

template <class Row>
void copy_to_rows(const RanksOfRows& ranks, const Row* by_rank, Row* by_row, const LaunchContext& context) {
  constexpr int kWords = sizeof(Row) / sizeof(unsigned long long);
  static_assert(sizeof(Row) % sizeof(unsigned long long) == 0 && alignof(Row) >= alignof(unsigned long long));
  if (ranks.n_rows == 0) return;
  rows_of_ranks_kernel<<<blocks_for(ranks.n_rows * kWords), kThreads, 0, context.stream>>>(
      ranks, kWords, reinterpret_cast<const unsigned long long*>(by_rank),
      reinterpret_cast<unsigned long long*>(by_row));
  B3DGS_CUDA_CHECK_LAUNCH();
}

}  // namespace

void copy_seen(const CopySeenArgs& args, const LaunchContext& context) {
  if (args.n_splats == 0) return;
  copy_seen_kernel<<<blocks_for(args.n_splats), kThreads, 0, context.stream>>>(args);
  B3DGS_CUDA_CHECK_LAUNCH();
}

void load_rows(const LoadRowsArgs& args, const LaunchContext& context) {
  reset_counts(args.out.counts, args.rows.n_splats, context);
  if (args.rows.n_splats == 0) return;
  load_rows_kernel<<<blocks_for(args.rows.n_splats), kThreads, 0, context.stream>>>(args);
  B3DGS_CUDA_CHECK_LAUNCH();
}

void rows_of_ranks(const RanksOfRows& ranks, const SplatGradSum* by_rank, SplatGradSum* by_row,
                   const LaunchContext& context) {
  copy_to_rows(ranks, by_rank, by_row, context);
}
void rows_of_ranks(const RanksOfRows& ranks, const ScoreSums* by_rank, ScoreSums* by_row,
                   const LaunchContext& context) {
  copy_to_rows(ranks, by_rank, by_row, context);
}

}  // namespace b3dgs::cuda
