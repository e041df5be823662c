// Geometry pass: depth, normals and confidence of the surface that a view shows.
//
// Kernel 1, plane_kernel: a thread per row computes the plane of its splat.
//
// Kernel 2, geometry_kernel. It works on the tiles of either family. A block has as many threads as a tile has pixels.
//   Grid: a block per tile, longest list first. Warp: a sub-tile of 8 x 4 pixels. Thread: one pixel.
//   Stage: each thread copies one splat and its plane asynchronously, while the previous batch is blended.
//   Blend: a warp takes the splats whose boxes reach its sub-tile, in order. It stops once all its pixels are finished.
//   Barriers: one per batch.

#include <cuda_pipeline.h>

#include "raster/cuda/forward/tile_blend.cuh"
#include "raster/cuda/launch.cuh"
#include "raster/cuda/project.cuh"
#include "raster/math/plane.h"
#include "raster/math/surface_blend.h"

namespace b3dgs::cuda {
namespace {

constexpr int kPlaneThreads = 128;
constexpr int kMostThreads = kCudaTilePixels;

template <bool kAntialiasing, class Lens>
__global__ void __launch_bounds__(kPlaneThreads)
    plane_kernel(const PlaneArgs args, const ProjectOutputs projected, std::int64_t n_rows, PlaneRow* planes) {
  const std::int64_t row = own_row<kPlaneThreads>();
  if (row >= n_rows || projected.radii[row] == 0) return;
  // The second splat of a panorama's Gaussian has another row, but the same plane.
  const PlaneRow plane =
      plane_row<kAntialiasing>(args.gaussians, projected.splats[row].gaussian, make_view_transform<float>(args.view),
                               lens_of<Lens>(args.view), args.kind);
  auto* const words = reinterpret_cast<float4*>(planes + row);
  words[0] = make_float4(plane.value, plane.slope_x, plane.slope_y, plane.variance);
  words[1] = make_float4(plane.normal.x, plane.normal.y, plane.normal.z, 0);
}

/// A batch of splats in shared memory, one per thread of the block.
struct SurfaceBatch {
  float4 mean[kMostThreads], conic[kMostThreads];
  float4 value[kMostThreads], normal[kMostThreads];  // the two words of a PlaneRow
  float2 extent[kMostThreads];

  /// Starts copying a splat to the entry of this thread.
  __device__ __forceinline__ void copy(const GeometryArgs& args, std::int32_t id) {
    const auto* const splat = reinterpret_cast<const float4*>(args.splats + id);
    const auto* const plane = reinterpret_cast<const float4*>(args.planes + id);
    __pipeline_memcpy_async(mean + threadIdx.x, splat, sizeof(float4));
    __pipeline_memcpy_async(conic + threadIdx.x, splat + 1, sizeof(float4));
    __pipeline_memcpy_async(value + threadIdx.x, plane, sizeof(float4));
    __pipeline_memcpy_async(normal + threadIdx.x, plane + 1, sizeof(float4));
    __pipeline_memcpy_async(extent + threadIdx.x, args.extents + id, sizeof(float2));
  }
  __device__ __forceinline__ PlaneRow plane(int index) const {
    const float4 v = value[index], n = normal[index];
    return {v.x, v.y, v.z, v.w, {n.x, n.y, n.z}, 0};
  }
};

__global__ void __launch_bounds__(kMostThreads)
    geometry_kernel(const GeometryArgs args, const std::int32_t* __restrict__ tiles_by_length) {
  __shared__ SurfaceBatch batches[2];  // one is blended while the other is loaded
  const std::int32_t tile = tiles_by_length[blockIdx.x];
  const auto thread = static_cast<std::int32_t>(threadIdx.x), n_threads = static_cast<std::int32_t>(blockDim.x);
  const TilePixel at = tile_pixel(args.grid, tile, sub_tile_pixel(thread));
  const float center_x = at.center_x(), center_y = at.center_y();
  const float left = __shfl_sync(kFullWarp, center_x, 0), top = __shfl_sync(kFullWarp, center_y, 0);
  const std::int32_t* const ids = args.bins.splat_ids + args.bins.tile_offsets[tile];
  const std::int32_t n = list_length(args.bins, tile);

  SurfacePixel<float> pixel{at.inside ? 1.0f : kClosedPixel, 0, 0, 0, 0, 0, 0, 0, 0};
  std::int32_t next = thread < n ? ids[thread] : -1;  // the next splat that this thread stages
  int turn = 1;
  for (std::int32_t start = -n_threads;; start += n_threads, turn ^= 1) {
    const SurfaceBatch& batch = batches[turn];
    __pipeline_wait_prior(0);
    // The one barrier per batch. This batch is complete, and all threads have finished with the previous one.
    if (__syncthreads_and(is_finished(pixel.transmittance)) || start >= n) break;
    if (next >= 0) batches[turn ^ 1].copy(args, next);
    __pipeline_commit();
    const std::int32_t ahead = start + 2 * n_threads + thread;
    next = ahead < n ? ids[ahead] : -1;

    const int count = start < 0 ? 0 : min(n - start, n_threads);
    for (int run = 0; run < count; run += kWarpSize) {
      if (!__any_sync(kFullWarp, is_open(pixel.transmittance))) break;
      const int tested = run + lane_id();
      const bool reaches = tested < count && reaches_sub_tile(batch.mean[tested].x, batch.mean[tested].y,
                                                              batch.extent[tested], left, top);
      for (unsigned chosen = __ballot_sync(kFullWarp, reaches); chosen != 0; chosen &= chosen - 1) {
        const int index = run + __ffs(static_cast<int>(chosen)) - 1;
        const SplatShape<float> shape = make_splat_shape(batch.mean[index], batch.conic[index]);
        const Footprint<float> footprint = evaluate_footprint(shape, center_x, center_y);
        if (!footprint.contributes) continue;
        blend_surface(pixel, args.kind, batch.plane(index), true, evaluate_alpha(footprint.power).alpha,
                      center_x - shape.mean_x, center_y - shape.mean_y);
      }
    }
  }
  if (!at.inside) return;
  store_surface(args, at.x, at.y,
                {magnitude(pixel.transmittance), pixel.first, pixel.share, pixel.offset, pixel.square, pixel.variance,
                 Vec3f{pixel.normal_x, pixel.normal_y, pixel.normal_z}});
}

}  // namespace

void splat_planes(const PlaneArgs& args, const ProjectOutputs& projected, std::int64_t n_rows, PlaneRow* planes,
                  const LaunchContext& context) {
  with_lens(args.view.lens, [&](const auto& lens) {
    using Lens = std::decay_t<decltype(lens)>;
    launch_blocks(args.antialiasing ? plane_kernel<true, Lens> : plane_kernel<false, Lens>,
                  n_blocks(n_rows, kPlaneThreads), kPlaneThreads, context, args, projected, n_rows, planes);
  });
}

void geometry(const GeometryArgs& args, const std::int32_t* tiles_by_length, const LaunchContext& context) {
  launch_blocks(geometry_kernel, args.grid.n_tiles(), args.grid.tile.width * args.grid.tile.height, context, args,
                tiles_by_length);
}

}  // namespace b3dgs::cuda
