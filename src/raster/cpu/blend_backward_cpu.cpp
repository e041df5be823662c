// Backward blend. Threads take tiles from an atomic counter; SIMD lanes are pixels; a tile's splats are visited back to
// front. The gradient of a (tile, splat) pair is summed over the tile's pixels in registers and written once, to the
// pair's slot: nothing is stored per pixel and splat, and no two threads write to the same place.

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "raster/cpu/blend_backward_cpu.cpp"
#include <hwy/foreach_target.h>
// Everything below is compiled once per instruction set.
#include "raster/cpu/forward/lanes-inl.h"
// After lanes-inl.h, whose SIMD type it computes on.
#include "raster/math/blend.h"

#include <algorithm>

#include "core/parallel.h"
#include "raster/cpu/passes.h"
#include "raster/math/tiling.h"

HWY_BEFORE_NAMESPACE();
namespace b3dgs {
namespace HWY_NAMESPACE {
namespace {

/// Pixels of one tile as planes. Rows are padded to whole vectors; padding has no last splat and no gradient.
struct TileGradients {
  static constexpr int kCapacity = cpu::kMaxTileSide * cpu::kMaxTileSide;
  HWY_ALIGN float transmittance[kCapacity], behind[kCapacity];  // ReverseState
  HWY_ALIGN float red[kCapacity], green[kCapacity], blue[kCapacity], depth[kCapacity];
  HWY_ALIGN std::int32_t last[kCapacity];
  std::int32_t row_last[cpu::kMaxTileSide];  // largest `last` of each row
  Rect rect;
  int rows, row_vectors, stride;
  std::int32_t tile_last;  // largest `last` of the tile

  void begin(const BlendBackwardArgs& args, std::int32_t tile) {
    rect = tile_pixels(args.grid, tile);
    rows = rect.y_end - rect.y_begin;
    row_vectors = (args.grid.tile.width + lane_count() - 1) / lane_count();
    stride = row_vectors * lane_count();
    const int n = rows * stride;
    for (float* plane : {behind, red, green, blue, depth}) std::fill(plane, plane + n, 0.0f);
    std::fill(transmittance, transmittance + n, 1.0f);
    std::fill(last, last + n, -1);
    tile_last = -1;
    for (int row = 0; row < rows; ++row) {
      row_last[row] = -1;
      for (int column = 0; column < rect.x_end - rect.x_begin; ++column) {
        load_pixel(args, row, column);
        row_last[row] = std::max(row_last[row], last[row * stride + column]);
      }
      tile_last = std::max(tile_last, row_last[row]);
    }
  }

  void load_pixel(const BlendBackwardArgs& args, int row, int column) {
    const int p = row * stride + column;
    const std::int64_t pixel = std::int64_t{rect.y_begin + row} * args.grid.image_width + rect.x_begin + column;
    last[p] = args.last_ids[pixel];
    transmittance[p] = args.transmittance[pixel];
    if (args.grad.color != nullptr) {
      red[p] = args.grad.color[3 * pixel];
      green[p] = args.grad.color[3 * pixel + 1];
      blue[p] = args.grad.color[3 * pixel + 2];
      const Vec3f color{red[p], green[p], blue[p]};
      behind[p] = transmittance[p] * dot(color, args.background);
    }
    if (args.grad.depth != nullptr) depth[p] = args.grad.depth[pixel];
    if (args.grad.alpha != nullptr) behind[p] -= transmittance[p] * args.grad.alpha[pixel];
  }
};

/// SplatGrad, spread over lanes until the last row is done.
struct SplatGradLanes {
  Lanes log_alpha, mean_x, mean_y, cov_xx, cov_xy, cov_yy;
  Lanes red, green, blue;
  Lanes depth;
};

/// Sums the gradient of the splat at `position` of the list over `vectors` of `rows`. Returns false if no pixel of them
/// blended it.
template <bool kDepth>
HWY_INLINE bool backward_onto(TileGradients& tile, const Splat& splat, const PixelSpan& rows, const PixelSpan& vectors,
                              std::int32_t position, SplatGrad& out) {
  const auto shape = splat_shape<Lanes>(splat);
  const Lanes red(splat.red), green(splat.green), blue(splat.blue), depth(splat.depth);
  const IntTag di;
  const IntVec splat_position = hn::Set(di, position);
  const Lanes zero(0.0f);
  SplatGradLanes sums{zero, zero, zero, zero, zero, zero, zero, zero, zero, zero};
  bool any = false;
  const int lanes = lane_count();
  for (int v = vectors.begin; v < vectors.end; ++v) {
    const Lanes pixel_x = Lanes::iota(static_cast<float>(tile.rect.x_begin + v * lanes) + 0.5f);
    for (int row = rows.begin; row < rows.end; ++row) {
      if (tile.row_last[row] < position) continue;
      const Lanes pixel_y(static_cast<float>(tile.rect.y_begin + row) + 0.5f);
      const Footprint<Lanes> footprint = evaluate_footprint(shape, pixel_x, pixel_y);
      const int p = row * tile.stride + v * lanes;
      const LaneMask past{hn::RebindMask(FloatTag(), hn::Lt(hn::Load(di, tile.last + p), splat_position))};
      const LaneMask blended = footprint.contributes & !past;
      if (none(blended)) continue;
      any = true;
      const Alpha<Lanes> alpha = evaluate_alpha(footprint.power);
      const Lanes grad_red = Lanes::load(tile.red + p), grad_green = Lanes::load(tile.green + p),
                  grad_blue = Lanes::load(tile.blue + p), grad_depth = kDepth ? Lanes::load(tile.depth + p) : zero;
      const Lanes value_blue = kDepth ? multiply_add(blue, grad_blue, depth * grad_depth) : blue * grad_blue;
      const Lanes value = multiply_add(red, grad_red, multiply_add(green, grad_green, value_blue));
      ReverseState<Lanes> pixel{Lanes::load(tile.transmittance + p), Lanes::load(tile.behind + p)};
      const BlendGrad<Lanes> grad = blend_over_reverse(pixel, blended, alpha, value);
      pixel.transmittance.store(tile.transmittance + p);
      pixel.behind.store(tile.behind + p);

      accumulate(sums, footprint, grad, grad_red, grad_green, grad_blue, grad_depth);
    }
  }
  if (!any) return false;
  out = {sums.log_alpha.sum(), sums.mean_x.sum(), sums.mean_y.sum(), sums.cov_xx.sum(), sums.cov_xy.sum(),
         sums.cov_yy.sum(),    sums.red.sum(),    sums.green.sum(),  sums.blue.sum(),   kDepth ? sums.depth.sum() : 0};
  return true;
}

}  // namespace

void run_blend_backward(const BlendBackwardArgs& args, std::int64_t index) {
  constexpr std::int64_t kPrefetch = 16;  // entries to fetch ahead
  TileGradients tile;
  tile.begin(args, static_cast<std::int32_t>(index));
  const float left = static_cast<float>(tile.rect.x_begin), top = static_cast<float>(tile.rect.y_begin);
  const std::int64_t first = args.bins.tile_offsets[index], last = args.bins.tile_offsets[index + 1];
  for (std::int64_t i = last - 1; i >= first; --i) {
    SplatGrad grad{};
    const std::int64_t ahead = std::max(i - kPrefetch, first);
    cpu::prefetch_object(args.splats[args.bins.splat_ids[ahead]]);
    cpu::prefetch_object(args.extents[args.bins.splat_ids[ahead]]);
    cpu::prefetch_object(args.pair_grads[args.bins.pair_slots[ahead]]);
    const auto position = static_cast<std::int32_t>(i - first);
    if (position <= tile.tile_last) {
      const std::int32_t id = args.bins.splat_ids[i];
      const Splat& splat = args.splats[id];
      const PixelSpan rows = pixels_reached(splat.mean_y, args.extents[id].y, top, 0, tile.rows);
      const PixelSpan vectors = vectors_reached(splat.mean_x, args.extents[id].x, left, args.grid.tile.width);
      const bool any = args.grad.depth != nullptr ? backward_onto<true>(tile, splat, rows, vectors, position, grad)
                                                  : backward_onto<false>(tile, splat, rows, vectors, position, grad);
      if (!any) grad = {};
    }
    args.pair_grads[args.bins.pair_slots[i]] = grad;
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace b3dgs
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace b3dgs {
HWY_EXPORT(run_blend_backward);

namespace cpu {

void blend_backward(const BlendBackwardArgs& args) {
  parallel_pool(args.grid.n_tiles(), [&](std::int64_t tile, int) {
    HWY_DYNAMIC_DISPATCH(run_blend_backward)(args, tile);
  });
}

}  // namespace cpu
}  // namespace b3dgs
#endif
