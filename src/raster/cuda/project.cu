// Projection: Gaussians to splats.
//   Grid: a thread per Gaussian. project_splat() (raster/math) decides whether the view sees it; the thread then writes
//     splat, colour, extent and radius to the Gaussian's row, and the block adds its splats to the lengths of their
//     tiles' lists (tile_spans.cuh).
//   Shared memory: the rows of tiles of the block's splats, and counters of tiles. Barriers: to use it, and to count
//     splats.
//   In a panorama, a Gaussian at the seam has a second splat, in row N + i: the thread writes it after the block has
//     counted the first ones. copy_second_colors_kernel copies colours to them after a ColorPass. add_second_kernel
//     makes those of splats that were projected elsewhere.
//   For the host: ViewCounts, which size the buffers of binning.

#include <cstdint>

#include "core/cuda_rows.cuh"
#include "raster/cuda/launch.cuh"
#include "raster/cuda/project.cuh"
#include "raster/cuda/tile_spans.cuh"
#include "raster/math/project_splat.h"

namespace b3dgs::cuda {
namespace {

constexpr int kThreads = 128;

/// Instead of an SH degree: a ColorPass computes the colours.
constexpr int kNoColors = -1;

/// Projects Gaussian i and writes its row. Returns the rows of tiles that its splat touches, none if it is not seen.
template <int kShDegree, bool kAntialiasing, class Lens>
__device__ __forceinline__ TileRows project_one(const ProjectCudaArgs& args, std::int64_t i) {
  const GaussianArrays& g = args.gaussians;
  const TileGrid grid = with_constant_tiles(args.grid);
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

/// The same for the second splat of a panorama's Gaussian, from what was written of the first.
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

/// The second splats of the block. All its threads must call it, each with its Gaussian.
template <int kShDegree>
__device__ __forceinline__ void project_second_of_block(SpanTasks<kThreads>& tasks, const ProjectCudaArgs& args,
                                                        std::int64_t i) {
  const TileRows rows =
      i < args.gaussians.n_gaussians ? project_second<kShDegree>(args, i) : no_tile_rows(args.culling);
  if (args.out.list_growth != nullptr) count_spans(tasks, args.grid, rows, args.out.list_growth);
  count_splats(rows.begin < rows.end, &args.out.counts->n_second);
}

template <int kShDegree, bool kAntialiasing, class Lens>
__global__ void __launch_bounds__(kThreads) project_kernel(const ProjectCudaArgs args) {
  __shared__ SpanTasks<kThreads> tasks;
  const std::int64_t i = spread_row<kThreads>();
  const TileRows rows = i < args.gaussians.n_gaussians ? project_one<kShDegree, kAntialiasing, Lens>(args, i)
                                                       : no_tile_rows(args.culling);
  if (args.out.list_growth != nullptr) count_spans(tasks, args.grid, rows, args.out.list_growth);
  count_splats(rows.begin < rows.end, &args.out.counts->n_splats);
  if constexpr (!std::is_same_v<Lens, Pinhole>) {
    if (splats_per_gaussian(args.view.lens) == 2) project_second_of_block<kShDegree>(tasks, args, i);
  }
}

__global__ void __launch_bounds__(kThreads) add_second_kernel(const ProjectCudaArgs args) {
  __shared__ SpanTasks<kThreads> tasks;
  project_second_of_block</*kShDegree=*/0>(tasks, args, spread_row<kThreads>());  // with the colours that are there
}

__global__ void __launch_bounds__(kThreads)
    copy_second_colors_kernel(const ProjectOutputs projected, std::int64_t n_gaussians) {
  const std::int64_t i = own_row<kThreads>();
  if (i >= n_gaussians || projected.radii[n_gaussians + i] == 0) return;
  auto* const words = reinterpret_cast<float4*>(projected.splats + n_gaussians + i);
  words[2] = reinterpret_cast<const float4*>(projected.splats + i)[2];
}

__global__ void __launch_bounds__(kThreads) reset_counts_kernel(const ProjectOutputs out, std::int32_t n_tiles) {
  const auto tile = static_cast<std::int32_t>(blockIdx.x * kThreads + threadIdx.x);
  if (tile == 0) *out.counts = {0, 0, -1};
  if (tile <= n_tiles && out.list_growth != nullptr) out.list_growth[kCounterStride * tile] = 0;
}

template <bool kAntialiasing, class Lens>
void launch(const ProjectCudaArgs& args, const LaunchContext& context) {
  const auto blocks = static_cast<unsigned>((args.gaussians.n_gaussians + kThreads - 1) / kThreads);
  if (args.with_colors) {
    with_sh_degree(args.sh_degree, [&](auto degree) {
      project_kernel<degree.value, kAntialiasing, Lens><<<blocks, kThreads, 0, context.stream>>>(args);
    });
  } else {
    project_kernel<kNoColors, kAntialiasing, Lens><<<blocks, kThreads, 0, context.stream>>>(args);
  }
  B3DGS_CUDA_CHECK_LAUNCH();
}

}  // namespace

void reset_counts(const ProjectOutputs& out, const TileGrid& grid, const LaunchContext& context) {
  const std::int32_t n_tiles = grid.n_tiles();
  reset_counts_kernel<<<n_tiles / kThreads + 1, kThreads, 0, context.stream>>>(out, n_tiles);
  B3DGS_CUDA_CHECK_LAUNCH();
}

void project(const ProjectCudaArgs& args, const LaunchContext& context) {
  reset_counts(args.out, args.grid, context);
  if (args.gaussians.n_gaussians == 0) return;
  with_lens(args.view.lens, [&](const auto& lens) {
    using Lens = std::decay_t<decltype(lens)>;
    if (args.antialiasing) {
      launch<true, Lens>(args, context);
    } else {
      launch<false, Lens>(args, context);
    }
  });
}

void add_second(const ProjectCudaArgs& args, const LaunchContext& context) {
  launch_rows<kThreads>(add_second_kernel, args, args.gaussians.n_gaussians, context.stream);
}

void copy_second_colors(const ProjectOutputs& projected, std::int64_t n_gaussians, const LaunchContext& context) {
  if (n_gaussians == 0) return;
  const auto blocks = static_cast<unsigned>((n_gaussians + kThreads - 1) / kThreads);
  copy_second_colors_kernel<<<blocks, kThreads, 0, context.stream>>>(projected, n_gaussians);
  B3DGS_CUDA_CHECK_LAUNCH();
}

}  // namespace b3dgs::cuda
