// What passes over splats do besides projecting and blending them: a thread per splat or Gaussian, unless another is
// named. Rows are splats in the order of their Gaussians (args.h).
//   Views split at the splats:
//     copy_seen_kernel, after projection: copies each row from its Gaussian's.
//     load_rows_kernel, in place of projection: copies each row and counts its tiles, as projection does.
//   Inverse depth (math/project_splat.h): invert_depths_kernel, invert_depth_gradients_kernel.
//   Panoramas: join_second_kernel adds the sums of a Gaussian's second splat to those of its first.
//   Deterministic gradients: sum_splat_grads_kernel sums those of each splat's pairs in a fixed order. A warp per
//     splat: lanes take the pairs in turn, and the lanes are summed with shuffles.
//   For a later backward projection: keep_splat_records_kernel; keep_splats_kernel for splats drawn elsewhere.

#include <cstdint>

#include "core/cuda_rows.cuh"
#include "raster/cuda/project.cuh"
#include "raster/cuda/tile_spans.cuh"
#include "raster/math/project_splat.h"
#include "raster/math/tiling.h"

namespace b3dgs::cuda {
namespace {

constexpr int kThreads = 256;
constexpr int kGradWords = sizeof(SplatGradSum) / sizeof(float4);

__global__ void __launch_bounds__(kThreads) copy_seen_kernel(const CopySeenArgs args) {
  const std::int64_t m = own_row<kThreads>();
  if (m >= args.n_splats || (args.counts != nullptr && m >= args.counts->n_splats)) return;
  const std::int32_t i = args.seen[m];
  args.out.splats[m] = args.projected.splats[i];
  args.out.extents[m] = args.projected.extents[i];
  args.out.radii[m] = args.projected.radii[i];
}

__global__ void __launch_bounds__(kThreads) load_rows_kernel(const LoadRowsArgs args) {
  __shared__ SpanTasks<kThreads> tasks;
  const std::int64_t m = spread_row<kThreads>();
  TileRows rows = no_tile_rows(args.culling);
  if (m < args.rows.n_splats) {
    Splat splat = args.rows.splats[m];
    splat.gaussian = static_cast<std::int32_t>(m);
    const Vec2f extent = args.rows.extents[m];
    const std::int32_t radius = args.rows.radii[m];
    const bool is_drawn = touches_tiles(args.grid, args.culling, splat, extent, radius);
    args.out.splats[m] = splat;
    args.out.extents[m] = extent;
    args.out.radii[m] = is_drawn ? radius : 0;
    if (is_drawn) rows = tile_rows(args.grid, args.culling, splat, extent, radius);
  }
  count_spans(tasks, args.grid, rows, args.out.list_growth);
  count_splats(rows.begin < rows.end, &args.out.counts->n_splats);
}

__global__ void __launch_bounds__(kThreads) invert_depths_kernel(const InvertDepthsArgs args) {
  const std::int64_t i = own_row<kThreads>();
  if (i < args.n_rows && args.radii[i] > 0) invert_depth(args.splats[i]);
}

__global__ void __launch_bounds__(kThreads) invert_depth_gradients_kernel(const InvertDepthsArgs args) {
  const std::int64_t i = own_row<kThreads>();
  if (i >= args.n_rows || args.radii[i] == 0) return;
  args.splat_grads[i].sum.depth = depth_gradient(args.splats[i], args.splat_grads[i].sum.depth);
}

__device__ __forceinline__ void add(float4& sum, float4 value) {
  sum = make_float4(sum.x + value.x, sum.y + value.y, sum.z + value.z, sum.w + value.w);
}

__device__ __forceinline__ void join(SplatGradSum& first, const SplatGradSum& second) {
  auto* const words = reinterpret_cast<float4*>(&first);
  for (int k = 0; k < kGradWords; ++k) add(words[k], reinterpret_cast<const float4*>(&second)[k]);
}
__device__ __forceinline__ void join(ScoreSums& first, const ScoreSums& second) {
  first.error += second.error;
  first.weight += second.weight;
  first.max_weight = fmaxf(first.max_weight, second.max_weight);
}

template <class Sums>
__global__ void __launch_bounds__(kThreads) join_second_kernel(const JoinSecondArgs<Sums> args) {
  const std::int64_t i = own_row<kThreads>();
  if (i >= args.n_gaussians || args.radii[args.n_gaussians + i] == 0) return;
  join(args.sums[i], args.sums[args.n_gaussians + i]);
}

__global__ void __launch_bounds__(kThreads) sum_splat_grads_kernel(const SumSplatGradsArgs args) {
  const std::int64_t splat = own_row<kThreads>() / kWarpSize;
  if (splat >= args.n_rows) return;
  float4 sum[kGradWords]{};
  for (std::int64_t slot = args.slot_offsets[splat] + lane_id(); slot < args.slot_offsets[splat + 1];
       slot += kWarpSize) {
    const auto* const words = reinterpret_cast<const float4*>(args.pair_grads + slot);
    for (int k = 0; k < kGradWords; ++k) add(sum[k], words[k]);
  }
  auto* const out = reinterpret_cast<float4*>(args.splat_grads + splat);
#pragma unroll
  for (int k = 0; k < kGradWords; ++k) {
    const float4 whole = make_float4(warp_sum(sum[k].x), warp_sum(sum[k].y), warp_sum(sum[k].z), warp_sum(sum[k].w));
    if (lane_id() == 0) out[k] = whole;
  }
}

__global__ void __launch_bounds__(kThreads) keep_splat_records_kernel(const SplatRecordArgs args) {
  const std::int64_t i = own_row<kThreads>();
  if (i >= args.n_gaussians) return;
  std::int32_t record = -1;
  Vec2f centre{0, 0};
  if (args.radii[i] > 0) {
    record = atomicAdd(args.n_records, 1);
    const SplatGrad sum = args.splat_grads[i].sum;
    args.out.records[record] = {sum, static_cast<std::int32_t>(i), args.splats[i].clamped};
    centre = centre_gradient(Vec2f{sum.mean_x, sum.mean_y});
  }
  args.out.record_of_gaussian[i] = record;
  reinterpret_cast<float2*>(args.out.means2d)[i] = make_float2(centre.x, centre.y);
}

__global__ void __launch_bounds__(kThreads) keep_splats_kernel(const KeepSplatsArgs args) {
  const std::int64_t m = own_row<kThreads>();
  if (m < args.rows.n_splats) keep_splat(args, m);
}

}  // namespace

void copy_seen(const CopySeenArgs& args, const LaunchContext& context) {
  launch_rows<kThreads>(copy_seen_kernel, args, args.n_splats, context.stream);
}

void load_rows(const LoadRowsArgs& args, const LaunchContext& context) {
  reset_counts(args.out, args.grid, context);
  launch_rows<kThreads>(load_rows_kernel, args, args.rows.n_splats, context.stream);
}

void invert_depths(const InvertDepthsArgs& args, const LaunchContext& context) {
  launch_rows<kThreads>(invert_depths_kernel, args, args.n_rows, context.stream);
}

void invert_depth_gradients(const InvertDepthsArgs& args, const LaunchContext& context) {
  launch_rows<kThreads>(invert_depth_gradients_kernel, args, args.n_rows, context.stream);
}

void sum_splat_grads(const SumSplatGradsArgs& args, const LaunchContext& context) {
  launch_rows<kThreads>(sum_splat_grads_kernel, args, args.n_rows * kWarpSize, context.stream);
}

void join_second(const JoinSecondArgs<SplatGradSum>& args, const LaunchContext& context) {
  launch_rows<kThreads>(join_second_kernel<SplatGradSum>, args, args.n_gaussians, context.stream);
}

void join_second(const JoinSecondArgs<ScoreSums>& args, const LaunchContext& context) {
  launch_rows<kThreads>(join_second_kernel<ScoreSums>, args, args.n_gaussians, context.stream);
}

void keep_splat_records(const SplatRecordArgs& args, const LaunchContext& context) {
  launch_rows<kThreads>(keep_splat_records_kernel, args, args.n_gaussians, context.stream);
}

void keep_splats(const KeepSplatsArgs& args, const LaunchContext& context) {
  if (args.n_gaussians == 0) return;
  const auto fill = [&](void* rows, int value, std::size_t row_bytes) {
    const std::size_t bytes = static_cast<std::size_t>(args.n_gaussians) * row_bytes;
    B3DGS_CUDA_CHECK(cudaMemsetAsync(rows, value, bytes, context.stream));
  };
  fill(args.out.record_of_gaussian, 0xff, sizeof(std::int32_t));  // -1
  fill(args.out.means2d, 0, 2 * sizeof(float));
  fill(args.radii, 0, sizeof(std::int32_t));
  launch_rows<kThreads>(keep_splats_kernel, args, args.rows.n_splats, context.stream);
}

}  // namespace b3dgs::cuda
