// Backward blend, per splat: a warp owns a bucket of 32 list entries, a lane one splat, and the tile's pixels stream
// through the lanes. Pixel t enters lane 0 with its state from before the bucket; each step hands (transmittance,
// remaining) to the next lane, so that every splat sees the pixel in the order of the list. Gradients stay in registers
// until the end, and a splat's tile costs three vector atomics.
//
// Buckets are of one size whatever the tile's list, so the launch is balanced by construction. Pixels that finished
// before the bucket, and sub-tiles of 8 x 4 that no splat of it reaches, never enter the stream.

#include "raster/cuda/backward_table.h"
#include "raster/cuda/launch.cuh"
#include "raster/cuda/splat_grad.cuh"
#include "raster/cuda/tile_blend.cuh"

namespace b3dgs::cuda {
namespace {

constexpr int kWarps = 4;
constexpr int kRing = 128;  // entries: 31 still in the lanes behind lane 0, up to 31 left ahead, 32 just added

/// Pixels on their way through the lanes of one warp.
struct PixelRing {
  float2 center[kRing];
  std::int32_t last[kRing];
  float2 state[kRing];  // transmittance, remaining
  float4 color[kRing];  // gradient by red, green, blue; by depth
};

template <int kTilePixels, bool kWithDepth>
__global__ void __launch_bounds__(kWarps* kWarpSize) backward_per_splat_kernel(const BlendBackwardCudaArgs args) {
  __shared__ PixelRing rings[kWarps];
  PixelRing& ring = rings[threadIdx.x / kWarpSize];
  const BlendBackwardArgs& blend = args.blend;
  const int lane = lane_id();

  const std::int64_t bucket = static_cast<std::int64_t>(blockIdx.x) * kWarps + threadIdx.x / kWarpSize;
  if (bucket >= args.n_buckets_max) return;
  const std::int32_t tile = args.tile_of_bucket[bucket];
  if (tile < 0) return;
  const auto start = static_cast<std::int32_t>((bucket - args.buckets.offsets[tile]) * kWarpSize);
  const std::int64_t first = blend.bins.tile_offsets[tile];
  const auto n = static_cast<std::int32_t>(blend.bins.tile_offsets[tile + 1] - first);
  const std::int32_t own_position = start + lane;

  SplatShape<float> shape{};
  float4 color{};
  float depth = 0;
  Vec2f extent{};
  std::int32_t id = -1;
  if (own_position < n) {
    id = blend.bins.splat_ids[first + own_position];
    const SplatPlace place = load_place(blend.splats, id);
    shape = make_splat_shape(place, load_conic(blend.splats, id));
    color = load_color(blend.splats, id).v;
    depth = place.v.w;
    extent = blend.extents[id];
  }

  SplatGrad sum{};
  BackwardState<float> state{};
  int step = 0;      // entry that is in lane 0
  int produced = 0;  // entries in the ring so far
  int group = 0;     // next sub-tile to look at
  constexpr int kGroups = kTilePixels / kWarpSize;

  const auto add_group = [&] {
    const TilePixel at = tile_pixel(blend.grid, tile, sub_tile_pixel(group * kWarpSize + lane));
    ++group;
    // Does any splat of the bucket reach the sub-tile? Lane 0 holds its upper left pixel.
    const float left = __shfl_sync(kFullWarp, at.center_x(), 0), top = __shfl_sync(kFullWarp, at.center_y(), 0);
    const bool reaches = id >= 0 && shape.mean_x + extent.x >= left && shape.mean_x - extent.x <= left + 7 &&
                         shape.mean_y + extent.y >= top && shape.mean_y - extent.y <= top + 3;
    if (__ballot_sync(kFullWarp, reaches) == 0) return;
    const std::int64_t pixel = static_cast<std::int64_t>(at.y) * blend.grid.image_width + at.x;
    const std::int32_t last = at.inside ? blend.last_ids[pixel] : -1;
    const bool alive = last >= start;
    const unsigned living = __ballot_sync(kFullWarp, alive);
    if (alive) {
      const PixelGrad g = load_pixel_grad(blend, pixel);
      const std::int64_t kept = bucket * kTilePixels + at.index;
      const float4 light = args.buckets.light[kept];
      const float* const shown = blend.rendered.color + 3 * pixel;
      float remaining = g.color.x * (shown[0] - light.y) + g.color.y * (shown[1] - light.z) +
                        g.color.z * (shown[2] - light.w) - alpha_part(blend, pixel);
      if constexpr (kWithDepth) remaining += g.depth * (blend.rendered.depth[pixel] - args.buckets.depth[kept]);
      const int slot = (produced + __popc(living & ((1u << lane) - 1))) % kRing;
      ring.center[slot] = make_float2(at.center_x(), at.center_y());
      ring.last[slot] = last;
      ring.state[slot] = make_float2(light.x, remaining);
      ring.color[slot] = make_float4(g.color.x, g.color.y, g.color.z, g.depth);
    }
    produced += __popc(living);
    __syncwarp();  // entries are visible to all lanes
  };

  const auto advance = [&] {
    state.transmittance = __shfl_up_sync(kFullWarp, state.transmittance, 1);
    state.remaining = __shfl_up_sync(kFullWarp, state.remaining, 1);
    const int entry = step - lane;
    const int slot = entry & (kRing - 1);
    ++step;
    if (entry < 0 || entry >= produced) return;
    if (lane == 0) {
      const float2 entering = ring.state[slot];
      state = {entering.x, entering.y};
    }
    const float2 center = ring.center[slot];
    const Reach<float> reach = evaluate_reach(shape, center.x, center.y);
    if (!reach.contributes || own_position > ring.last[slot]) return;
    const float4 g = ring.color[slot];
    float value = g.x * color.x + g.y * color.y + g.z * color.z;
    if constexpr (kWithDepth) value += g.w * depth;
    const BlendGrad<float> part = blend_over_backward(state, true, evaluate_alpha(reach.power), value);
    accumulate(sum, reach, part, make_float3(g.x, g.y, g.z), g.w);
  };

  while (true) {
    while (group < kGroups && produced - step < kWarpSize) add_group();
    if (step >= produced) break;
    for (const int end = produced; step < end;) advance();
    __syncwarp();  // everyone is done with entries that the next group may overwrite
  }
  if (produced > 0) {
    for (const int end = produced + kWarpSize - 1; step < end;) advance();
  }
  if (id < 0) return;
  if (sum.q != 0 || sum.red != 0 || sum.green != 0 || sum.blue != 0 || sum.depth != 0) {
    atomic_add(args.splat_grads + id, sum);
  }
}

}  // namespace

void launch_backward_per_splat(const BlendBackwardCudaArgs& args, const LaunchContext& context) {
  if (args.n_buckets_max == 0) return;
  const auto blocks = static_cast<unsigned>((args.n_buckets_max + kWarps - 1) / kWarps);
  const bool with_depth = args.blend.grad.depth != nullptr;
  with_tile_pixels(args.blend.grid.tile, [&](auto pixels) {
    if (with_depth) {
      backward_per_splat_kernel<pixels.value, true><<<blocks, kWarps * kWarpSize, 0, context.stream>>>(args);
    } else {
      backward_per_splat_kernel<pixels.value, false><<<blocks, kWarps * kWarpSize, 0, context.stream>>>(args);
    }
  });
  B3DGS_CUDA_CHECK_LAUNCH();
}

KernelResources backward_per_splat_resources(const TileShape& tile) {
  KernelResources resources;
  with_tile_pixels(tile, [&](auto pixels) {
    resources = kernel_resources(backward_per_splat_kernel<pixels.value, false>, kWarps * kWarpSize);
  });
  return resources;
}

}  // namespace b3dgs::cuda
