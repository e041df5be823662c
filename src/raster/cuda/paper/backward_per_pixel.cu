// Backward blend on the paper's lists, as unbalanced as naive is in the forward pass. The paper does not change the
// backward pass of the original 3DGS code, which has a thread per pixel.
//   Grid: a block of 128 threads per patch, assigned statically. Warp: 8 x 4 pixels. Thread: one pixel.
//   Start: finds the patch's last blended list entry with an atomic maximum in shared memory.
//   Loop: batches of list entries from that one to the front, staged in shared memory, a splat per thread. Each thread
//     steps over them back to front (blend_over_reverse()).
//   Per splat: the warp sums the gradients of its 32 pixels with shuffles, and one lane adds them to the splat with
//     atomics. Sums of different warps arrive in any order, so results differ in rounding from run to run.
//   Barriers: two at the start, two per batch.

#include "raster/cuda/backward/splat_grad.cuh"
#include "raster/cuda/launch.cuh"
#include "raster/cuda/paper/patch.cuh"

namespace b3dgs::cuda {
namespace {

constexpr int kThreads = kPatchThreads;

__global__ void __launch_bounds__(kThreads) backward_per_pixel_kernel(const BlendBackwardCudaArgs args) {
  __shared__ float4 means[kThreads], conics[kThreads], colors[kThreads];
  __shared__ std::int32_t ids[kThreads];
  __shared__ std::int32_t patch_last;
  const BlendBackwardArgs& blend = args.blend;
  const auto patch = static_cast<std::int32_t>(blockIdx.x);
  const TilePixel at = patch_pixel(blend.grid, patch, sub_tile_pixel(static_cast<std::int32_t>(threadIdx.x)));
  const std::int64_t pixel = static_cast<std::int64_t>(at.y) * blend.grid.image_width + at.x;
  const std::int32_t last = at.inside ? blend.last_ids[pixel] : -1;
  const PixelGrad g = at.inside ? load_pixel_grad(blend, pixel) : PixelGrad{};
  ReverseState<float> state{1, 0};
  if (at.inside) {
    state.transmittance = blend.transmittance[pixel];
    state.behind = loss_behind_list(blend, pixel, g);
  }

  if (threadIdx.x == 0) patch_last = -1;
  __syncthreads();
  atomicMax(&patch_last, last);
  __syncthreads();  // patch_last is final
  const std::int64_t first = blend.bins.tile_offsets[patch];
  const std::int32_t n = patch_last + 1;
  // Entry j of a batch is list entry end - j.
  for (std::int32_t end = n - 1; end >= 0; end -= kThreads) {
    __syncthreads();  // all threads have finished with the previous batch
    const std::int32_t entry = end - static_cast<std::int32_t>(threadIdx.x);
    if (entry >= 0) {
      const std::int32_t id = blend.bins.splat_ids[first + entry];
      ids[threadIdx.x] = id;
      means[threadIdx.x] = load_mean(blend.splats, id);
      conics[threadIdx.x] = load_conic(blend.splats, id);
      colors[threadIdx.x] = load_color(blend.splats, id);
    }
    __syncthreads();  // the batch is complete
    const int count = end + 1 < kThreads ? end + 1 : kThreads;
    for (int j = 0; j < count; ++j) {
      const SplatShape<float> shape = make_splat_shape(means[j], conics[j]);
      const Footprint<float> footprint = evaluate_footprint(shape, at.center_x(), at.center_y());
      const bool blended = footprint.contributes && end - j <= last;
      if (__ballot_sync(kFullWarp, blended) == 0) continue;
      SplatGrad grad{};
      if (blended) {
        const float4 color = colors[j];
        const float value = g.color.x * color.x + g.color.y * color.y + g.color.z * color.z + g.depth * means[j].w;
        const BlendGrad<float> part = blend_over_reverse(state, true, evaluate_alpha(footprint.power), value);
        accumulate(grad, footprint, part, g.color.x, g.color.y, g.color.z, g.depth);
      }
      grad = {warp_sum(grad.log_alpha), warp_sum(grad.mean_x), warp_sum(grad.mean_y), warp_sum(grad.cov_xx),
              warp_sum(grad.cov_xy),    warp_sum(grad.cov_yy), warp_sum(grad.red),    warp_sum(grad.green),
              warp_sum(grad.blue),      warp_sum(grad.depth)};
      if (lane_id() == 0) atomic_add(args.splat_grads + ids[j], grad);
    }
  }
}

}  // namespace

void launch_backward_per_pixel(const BlendBackwardCudaArgs& args, const LaunchContext& context) {
  launch_blocks(backward_per_pixel_kernel, args.blend.grid.n_tiles(), kThreads, context, args);
}

}  // namespace b3dgs::cuda
