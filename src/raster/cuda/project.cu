// Projection: Gaussians to splats.
//   Grid: a thread per Gaussian. project_splat() (raster/math) decides whether the view sees it; the thread then writes
//     splat, colour, extent, radius, number of tiles and depth bits to the Gaussian's row.
//   Shared memory: the block's numbers of splats and pairs (project.cuh).
//   Barriers: two, around the block's sums.
//   For the host: ViewCounts, read once per forward pass to size the buffers of binning.

#include <cstdint>

#include "raster/cuda/launch.cuh"
#include "raster/cuda/project.cuh"
#include "raster/math/project_splat.h"

namespace b3dgs::cuda {
namespace {

constexpr int kThreads = 128;

/// Instead of an SH degree: a ColorPass computes the colours.
constexpr int kNoColors = -1;

/// Projects Gaussian i and writes its row. Returns the number of tiles that its splat touches, 0 if it is not seen.
template <int kShDegree, bool kAntialiasing>
__device__ __forceinline__ std::int32_t project_one(const ProjectCudaArgs& args, std::int64_t i) {
  const GaussianArrays& g = args.gaussians;
  const ViewTransform<float> view = make_view_transform<float>(args.view);
  const ProjectedGaussian projected =
      project_splat<TileCount::kAll, kAntialiasing>(g, i, view, args.near_plane, args.culling, args.grid);
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
  }
  args.out.radii[i] = is_seen ? projected.radius : 0;
  args.out.n_tiles[i] = projected.n_tiles;
  args.out.depth_bits[i] = is_seen ? __float_as_uint(projected.splat.depth) : 0;
  if (!is_valid) note_invalid(args.out.counts, i);
  return projected.n_tiles;
}

template <int kShDegree, bool kAntialiasing>
__global__ void __launch_bounds__(kThreads) project_kernel(const ProjectCudaArgs args) {
  __shared__ unsigned long long block_splats, block_pairs;
  if (threadIdx.x == 0) block_splats = block_pairs = 0;
  __syncthreads();

  const std::int64_t i = static_cast<std::int64_t>(blockIdx.x) * kThreads + threadIdx.x;
  const std::int32_t n_tiles = i < args.gaussians.n_gaussians ? project_one<kShDegree, kAntialiasing>(args, i) : 0;
  count_splat(n_tiles, block_splats, block_pairs, args.out.counts);
}

__global__ void reset_counts_kernel(ViewCounts* counts, std::int64_t n_gaussians) {
  *counts = {0, 0, n_gaussians};
}

template <bool kAntialiasing>
void launch(const ProjectCudaArgs& args, const LaunchContext& context) {
  const auto blocks = static_cast<unsigned>((args.gaussians.n_gaussians + kThreads - 1) / kThreads);
  if (args.with_colors) {
    with_sh_degree(args.sh_degree, [&](auto degree) {
      project_kernel<degree.value, kAntialiasing><<<blocks, kThreads, 0, context.stream>>>(args);
    });
  } else {
    project_kernel<kNoColors, kAntialiasing><<<blocks, kThreads, 0, context.stream>>>(args);
  }
  B3DGS_CUDA_CHECK_LAUNCH();
}

}  // namespace

void reset_counts(ViewCounts* counts, std::int64_t n_gaussians, const LaunchContext& context) {
  reset_counts_kernel<<<1, 1, 0, context.stream>>>(counts, n_gaussians);
  B3DGS_CUDA_CHECK_LAUNCH();
}

void project(const ProjectCudaArgs& args, const LaunchContext& context) {
  const std::int64_t n = args.gaussians.n_gaussians;
  reset_counts(args.out.counts, n, context);
  if (n == 0) return;
  if (args.antialiasing) {
    launch<true>(args, context);
  } else {
    launch<false>(args, context);
  }
}

}  // namespace b3dgs::cuda
