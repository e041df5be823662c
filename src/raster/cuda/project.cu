// Projection from Gaussians to splats.
//   Grid: a thread per Gaussian. project_splat() (raster/math) decides whether it is visible. The thread then writes
//     splat, colour, extent and radius to the Gaussian's row, and the block adds its splats to the list lengths of
//     their tiles (tile_spans.cuh).
//   Shared memory: the rows of tiles of the block's splats, and counters of tiles. Barriers: to use it, and to count
//     splats.
//   In a panorama, a Gaussian at the seam has a second splat, in row N + i. The thread writes it after the block has
//     counted the first ones.
//   load_rows_kernel, for splats that were projected elsewhere, copies rows instead of projecting.
//   The host gets ViewCounts, which determine the size of the buffers of binning.

#include <cstdint>

#include "raster/cuda/launch.cuh"
#include "raster/cuda/project.cuh"
#include "raster/cuda/tile_spans.cuh"
#include "raster/math/project_splat.h"

namespace b3dgs::cuda {
namespace {

constexpr int kThreads = 128;

/// Replaces an SH degree if a ColorPass computes the colours.
constexpr int kNoColors = -1;

/// Projects Gaussian i and writes its row. Returns the rows of tiles that its splat touches, none if it is not visible.
template <int kShDegree, bool kAntialiasing, class Lens>
__device__ __forceinline__ TileRows project_one(const ProjectCudaArgs& args, std::int64_t i) {
  const GaussianArrays& g = args.gaussians;
  const TileGrid grid = with_known_tiles(args.grid);
  const ViewTransform<float> view = make_view_transform<float>(args.view);
  const ProjectedGaussian projected =
      project_splat<kAntialiasing>(g, i, view, lens_of<Lens>(args.view), args.near_plane, args.culling, grid);
  const bool is_seen = projected.outcome == Outcome::kSeen;
  bool is_valid = projected.outcome != Outcome::kInvalid;
  if (is_seen) {
    float4* const words = reinterpret_cast<float4*>(args.out.splats + i);
    words[0] = reinterpret_cast<const float4*>(&projected.splat)[0];
    words[1] = reinterpret_cast<const float4*>(&projected.splat)[1];
    if constexpr (kShDegree != kNoColors) {
      const float4 color = splat_color<kShDegree>(g, args.view.center, i, g.shN + rest_floats(g.sh_degree_max) * i);
      is_valid = is_usable_color(color.x, color.y, color.z);
      words[2] = color;
    }
    args.out.extents[i] = projected.extent;
    if (args.out.sums != nullptr) args.out.sums[i] = {};
  }
  args.out.radii[i] = is_seen ? projected.radius : 0;
  if (!is_valid) note_invalid(args.out.counts, i);
  if (!is_seen) return no_tile_rows(args.culling);
  return tile_rows(grid, args.culling, projected.splat, projected.extent, projected.radius);
}

/// Projects the second splat of a panorama's Gaussian, given the data that was written for the first.
template <int kShDegree>
__device__ __forceinline__ TileRows project_second(const ProjectCudaArgs& args, std::int64_t i) {
  const std::int64_t row = args.gaussians.n_gaussians + i;
  const auto* const words = reinterpret_cast<const float4*>(args.out.splats + i);
  ProjectedGaussian splat;
  splat.radius = args.out.radii[i];
  if (splat.radius > 0) {
    reinterpret_cast<float4*>(&splat.splat)[0] = words[0];
    reinterpret_cast<float4*>(&splat.splat)[1] = words[1];
    splat.extent = args.out.extents[i];
    splat = across_the_seam(splat, full_turn(args.view.fx), args.culling, args.grid);
  }
  const bool is_seen = splat.outcome == Outcome::kSeen;
  args.out.radii[row] = is_seen ? splat.radius : 0;
  if (!is_seen) return no_tile_rows(args.culling);
  auto* const out = reinterpret_cast<float4*>(args.out.splats + row);
  out[0] = reinterpret_cast<const float4*>(&splat.splat)[0];
  out[1] = reinterpret_cast<const float4*>(&splat.splat)[1];
  if constexpr (kShDegree != kNoColors) out[2] = words[2];
  args.out.extents[row] = splat.extent;
  if (args.out.sums != nullptr) args.out.sums[row] = {};
  return tile_rows(args.grid, args.culling, splat.splat, splat.extent, splat.radius);
}

/// Counts the block's splats, whose tiles are `rows`. In a panorama, it then makes the second splats. All threads of
/// the block must call it, each with its Gaussian.
template <int kShDegree, bool kMaySeam>
__device__ __forceinline__ void count_and_add_second(const ProjectCudaArgs& args, std::int64_t i,
                                                     const TileRows& rows) {
  __shared__ SpanTasks<kThreads> tasks;
  count_splats(tasks, args.grid, rows, args.out.list_growth, &args.out.counts->n_splats);
  if (!kMaySeam || splats_per_gaussian(args.view.lens) == 1) return;
  const TileRows second =
      i < args.gaussians.n_gaussians ? project_second<kShDegree>(args, i) : no_tile_rows(args.culling);
  count_splats(tasks, args.grid, second, args.out.list_growth, &args.out.counts->n_second);
}

template <int kShDegree, bool kAntialiasing, class Lens>
__global__ void __launch_bounds__(kThreads) project_kernel(const ProjectCudaArgs args) {
  const std::int64_t i = spread_row<kThreads>();
  const TileRows rows = i < args.gaussians.n_gaussians ? project_one<kShDegree, kAntialiasing, Lens>(args, i)
                                                       : no_tile_rows(args.culling);
  count_and_add_second<kShDegree, !std::is_same_v<Lens, Pinhole>>(args, i, rows);
}

__global__ void __launch_bounds__(kThreads) load_rows_kernel(const SplatRows given, const ProjectCudaArgs args) {
  const std::int64_t i = spread_row<kThreads>();
  TileRows rows = no_tile_rows(args.culling);
  if (i < given.n_splats) {
    Splat splat = given.splats[i];
    splat.gaussian = static_cast<std::int32_t>(i);
    const Vec2f extent = given.extents[i];
    const std::int32_t radius = given.radii[i];
    const bool is_drawn = touches_tiles(args.grid, args.culling, splat, extent, radius);
    args.out.splats[i] = splat;
    args.out.extents[i] = extent;
    args.out.radii[i] = is_drawn ? radius : 0;
    if (is_drawn) rows = tile_rows(args.grid, args.culling, splat, extent, radius);
  }
  count_and_add_second</*kShDegree=*/0, /*kMaySeam=*/true>(args, i, rows);  // keeps the existing colours
}

__global__ void __launch_bounds__(kThreads) reset_counts_kernel(const ProjectOutputs out, std::int32_t n_tiles) {
  const auto tile = static_cast<std::int32_t>(blockIdx.x * kThreads + threadIdx.x);
  if (tile == 0) *out.counts = {0, 0, -1};
  if (tile <= n_tiles && out.list_growth != nullptr) out.list_growth[kCounterStride * tile] = 0;
}

/// Resets the counts and list lengths of a view without splats.
void reset_counts(const ProjectCudaArgs& args, const LaunchContext& context) {
  const std::int32_t n_tiles = args.grid.n_tiles();
  launch_blocks(reset_counts_kernel, n_tiles / kThreads + 1, kThreads, context, args.out, n_tiles);
}

}  // namespace

void project(const ProjectCudaArgs& args, const LaunchContext& context) {
  reset_counts(args, context);
  const int degree_or_none = args.with_colors ? args.sh_degree : kNoColors;
  with_constants<kNoColors>(degree_or_none, args.antialiasing, args.view.lens,
                            [&](auto degree, auto antialiasing, auto lens) {
                              launch_blocks(project_kernel<degree.value, antialiasing.value, decltype(lens)>,
                                            n_blocks(args.gaussians.n_gaussians, kThreads), kThreads, context, args);
                            });
}

void load_rows(const SplatRows& rows, const ProjectCudaArgs& args, const LaunchContext& context) {
  reset_counts(args, context);
  launch_blocks(load_rows_kernel, n_blocks(rows.n_splats, kThreads), kThreads, context, rows, args);
}

}  // namespace b3dgs::cuda
