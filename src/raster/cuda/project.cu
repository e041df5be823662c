// Projection: one thread per Gaussian writes its splat, its box and the number of tiles it touches; blocks add up the
// view's totals before they touch the global counters.

#include <cstdint>

#include "raster/cuda/color.cuh"
#include "raster/cuda/launch.cuh"
#include "raster/cuda/warp.cuh"
#include "raster/projection.h"
#include "raster/tiling.h"

namespace b3dgs::cuda {
namespace {

constexpr int kThreads = 128;
constexpr float kLog2e = 1.44269504f;

/// log2 of the logistic function, exact in both tails.
__device__ __forceinline__ float log2_sigmoid(float logit) {
  const float tail = log1pf(__expf(-fabsf(logit)));
  return -kLog2e * (logit >= 0 ? tail : tail - logit);
}

/// In place of a degree of harmonics: a ColorPass finds the colours.
constexpr int kNoColors = -1;

struct Projected {
  int n_tiles = 0;
  float depth = 0;
  bool finite = true;
};

template <int kShDegree>
__device__ __forceinline__ Projected project_one(const ProjectCudaArgs& args, const ViewTransform<float>& view,
                                                 std::int64_t i) {
  Projected result;
  const GaussianArrays& g = args.gaussians;
  const Vec3f point = to_camera(view, load3(g.means, i));
  if (!isfinite(point.x + point.y + point.z)) {
    result.finite = false;
    return result;
  }
  if (point.z < args.near_plane) return result;
  const Vec3f log_scales = load3(g.log_scales, i);
  const float4 quat = reinterpret_cast<const float4*>(g.quats)[i];
  if (!isfinite(g.logit_opacities[i] + log_scales.x + log_scales.y + log_scales.z + quat.x + quat.y + quat.z +
                quat.w)) {
    result.finite = false;
    return result;
  }
  const float log2_opacity = log2_sigmoid(g.logit_opacities[i]);
  if (args.culling == Culling::kEllipse && log2_opacity < kLog2AlphaMin) return result;

  const Shape<float> shape = make_shape(log_scales, Vec4f{quat.x, quat.y, quat.z, quat.w});
  const Projection<float> p = project_gaussian(view, point, shape.factor);
  const float radius_px = ceilf(kSquareSigmas * largest_sigma(p.cov));
  if (!isfinite(p.mean2d.x + p.mean2d.y + p.conic.xx + p.conic.xy + p.conic.yy + log2_opacity) ||
      !(radius_px <= kRadiusMax)) {
    result.finite = false;
    return result;
  }
  const Splat splat{p.mean2d.x,
                    p.mean2d.y,
                    log2_opacity,
                    point.z,
                    kConicScale * p.conic.xx,
                    kConicScale * p.conic.xy,
                    kConicScale * p.conic.yy,
                    static_cast<std::int32_t>(i),
                    0,
                    0,
                    0,
                    0};
  const auto radius = static_cast<std::int32_t>(radius_px);
  const Vec2f extent = ellipse_extent(log2_opacity, p.cov);
  visit_tile_rows(args.grid, args.culling, splat, extent, radius,
                  [&](std::int32_t, TileSpan span) { result.n_tiles += span.end - span.begin; });
  if (result.n_tiles == 0) return result;
  result.depth = point.z;
  float4* const words = reinterpret_cast<float4*>(args.out.splats + i);
  words[0] = reinterpret_cast<const float4*>(&splat)[0];
  words[1] = reinterpret_cast<const float4*>(&splat)[1];
  if constexpr (kShDegree != kNoColors) {
    const float4 color = splat_color<kShDegree>(g, args.view.center, i, g.shN + rest_floats(g.sh_degree_max) * i);
    result.finite = isfinite(color.x + color.y + color.z);
    words[2] = color;
  }
  args.out.extents[i] = extent;
  args.out.radii[i] = radius;
  return result;
}

template <int kShDegree>
__global__ void __launch_bounds__(kThreads) project_kernel(const ProjectCudaArgs args) {
  __shared__ unsigned long long block_splats, block_isects;
  if (threadIdx.x == 0) block_splats = block_isects = 0;
  __syncthreads();

  const std::int64_t i = static_cast<std::int64_t>(blockIdx.x) * kThreads + threadIdx.x;
  Projected projected;
  if (i < args.gaussians.n_gaussians) {
    const ViewTransform<float> view = make_view_transform<float>(args.view);
    projected = project_one<kShDegree>(args, view, i);
    args.out.n_tiles[i] = projected.n_tiles;
    args.out.depth_bits[i] = __float_as_uint(projected.depth);
    if (projected.n_tiles == 0) args.out.radii[i] = 0;
    if (!projected.finite) note_not_finite(args.out.counts, i);
  }
  // One Gaussian touches at most all tiles, so a warp's sum can pass 32 bits only beyond 2^27 tiles.
  const int seen = __popc(__ballot_sync(kFullWarp, projected.n_tiles > 0));
  const unsigned pairs = __reduce_add_sync(kFullWarp, static_cast<unsigned>(projected.n_tiles));
  if (lane_id() == 0 && seen > 0) {
    atomicAdd(&block_splats, static_cast<unsigned long long>(seen));
    atomicAdd(&block_isects, static_cast<unsigned long long>(pairs));
  }
  __syncthreads();
  if (threadIdx.x == 0 && block_splats > 0) {
    atomicAdd(reinterpret_cast<unsigned long long*>(&args.out.counts->n_splats), block_splats);
    atomicAdd(reinterpret_cast<unsigned long long*>(&args.out.counts->n_isects), block_isects);
  }
}

__global__ void reset_counts_kernel(ViewCounts* counts, std::int64_t n_gaussians) {
  *counts = {0, 0, n_gaussians};
}

}  // namespace

void project(const ProjectCudaArgs& args, const LaunchContext& context) {
  const std::int64_t n = args.gaussians.n_gaussians;
  reset_counts_kernel<<<1, 1, 0, context.stream>>>(args.out.counts, n);
  B3DGS_CUDA_CHECK_LAUNCH();
  if (n == 0) return;
  const auto blocks = static_cast<unsigned>((n + kThreads - 1) / kThreads);
  if (args.color_pass == nullptr) {
    with_sh_degree(args.sh_degree,
                   [&](auto degree) { project_kernel<degree.value><<<blocks, kThreads, 0, context.stream>>>(args); });
    B3DGS_CUDA_CHECK_LAUNCH();
    return;
  }
  project_kernel<kNoColors><<<blocks, kThreads, 0, context.stream>>>(args);
  B3DGS_CUDA_CHECK_LAUNCH();
  args.color_pass->color({args.gaussians, args.view.center, args.sh_degree, args.out}, context);
}

}  // namespace b3dgs::cuda
