// Backward blend: tiles from the pool, lanes over pixels, splats back to front. Each (tile, splat)
// pair sums its gradient over the tile's pixels in registers and writes one record; nothing is stored per pixel and
// splat, and no two threads write to the same place.

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "raster/cpu/blend_backward_cpu.cpp"
#include <hwy/foreach_target.h>
// Once per target from here.
#include "raster/cpu/forward/lanes-inl.h"
// Highway's order: lanes first, then what computes on them.
#include "raster/math/blend.h"

#include <algorithm>

#include "core/parallel.h"
#include "raster/cpu/passes.h"
#include "raster/cpu/rasterize_cpu.h"
#include "raster/math/tiling.h"

HWY_BEFORE_NAMESPACE();
namespace b3dgs {
namespace HWY_NAMESPACE {
namespace {

/// Pixels of one tile in planes, rows padded to whole vectors; padding has no last splat and no gradient.
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

/// Sum over the pixels of the rows for the splat at `position` of the list. Returns false if it is blended nowhere.
HWY_INLINE bool backward_rows(TileGradients& tile, const Splat& splat, int row_begin, int row_end,
                              std::int32_t position, SplatGrad& out) {
  const SplatShape<Lanes> shape{Lanes(splat.mean_x),   Lanes(splat.mean_y),   Lanes(splat.log2_opacity),
                                Lanes(splat.conic_xx), Lanes(splat.conic_xy), Lanes(splat.conic_yy)};
  const Lanes red(splat.red), green(splat.green), blue(splat.blue), depth(splat.depth);
  const IntTag di;
  const IntVec own_position = hn::Set(di, position);
  const Lanes zero(0.0f);
  Lanes q = zero, q_x = zero, q_y = zero, q_xx = zero, q_xy = zero, q_yy = zero;
  Lanes sum_red = zero, sum_green = zero, sum_blue = zero, sum_depth = zero;
  bool any = false;
  const int lanes = lane_count();
  for (int row = row_begin; row < row_end; ++row) {
    if (tile.row_last[row] < position) continue;
    const Lanes pixel_y(static_cast<float>(tile.rect.y_begin + row) + 0.5f);
    for (int v = 0; v < tile.row_vectors; ++v) {
      const Lanes pixel_x = Lanes::iota(static_cast<float>(tile.rect.x_begin + v * lanes) + 0.5f);
      const Reach<Lanes> reach = evaluate_reach(shape, pixel_x, pixel_y);
      const int p = row * tile.stride + v * lanes;
      const LaneMask past{hn::RebindMask(FloatTag(), hn::Lt(hn::Load(di, tile.last + p), own_position))};
      const LaneMask blended = reach.contributes & !past;
      if (none(blended)) continue;
      any = true;
      const Alpha<Lanes> alpha = evaluate_alpha(reach.power);
      const Lanes grad_red = Lanes::load(tile.red + p), grad_green = Lanes::load(tile.green + p),
                  grad_blue = Lanes::load(tile.blue + p), grad_depth = Lanes::load(tile.depth + p);
      const Lanes value = multiply_add(
          red, grad_red, multiply_add(green, grad_green, multiply_add(blue, grad_blue, depth * grad_depth)));
      ReverseState<Lanes> pixel{Lanes::load(tile.transmittance + p), Lanes::load(tile.behind + p)};
      const BlendGrad<Lanes> grad = blend_over_reverse(pixel, blended, alpha, value);
      pixel.transmittance.store(tile.transmittance + p);
      pixel.behind.store(tile.behind + p);

      const Lanes along_x = grad.q * reach.pull_x, along_y = grad.q * reach.pull_y;
      q = q + grad.q;
      q_x = q_x + along_x;
      q_y = q_y + along_y;
      q_xx = multiply_add(along_x, reach.pull_x, q_xx);
      q_xy = multiply_add(along_x, reach.pull_y, q_xy);
      q_yy = multiply_add(along_y, reach.pull_y, q_yy);
      sum_red = multiply_add(grad.weight, grad_red, sum_red);
      sum_green = multiply_add(grad.weight, grad_green, sum_green);
      sum_blue = multiply_add(grad.weight, grad_blue, sum_blue);
      sum_depth = multiply_add(grad.weight, grad_depth, sum_depth);
    }
  }
  if (!any) return false;
  out = {q.sum(),    q_x.sum(),     q_y.sum(),       q_xx.sum(),     q_xy.sum(),
         q_yy.sum(), sum_red.sum(), sum_green.sum(), sum_blue.sum(), sum_depth.sum()};
  return true;
}

}  // namespace

void run_blend_backward(const BlendBackwardArgs& args, std::int64_t index) {
  TileGradients tile;
  tile.begin(args, static_cast<std::int32_t>(index));
  const float top = static_cast<float>(tile.rect.y_begin);
  const std::int64_t first = args.bins.tile_offsets[index], last = args.bins.tile_offsets[index + 1];
  for (std::int64_t i = last - 1; i >= first; --i) {
    SplatGrad grad{};
    const auto position = static_cast<std::int32_t>(i - first);
    if (position <= tile.tile_last) {
      const std::int32_t id = args.bins.splat_ids[i];
      const Splat& splat = args.splats[id];
      const float middle = splat.mean_y - top - 0.5f, reach = args.extents[id].y;
      const int row_begin = detail::floor_clamped(middle - reach, -1, tile.rows) + 1;
      const int row_end = detail::floor_clamped(middle + reach, -1, tile.rows - 1) + 1;
      if (!backward_rows(tile, splat, row_begin, row_end, position, grad)) grad = {};
    }
    args.isect_grads[args.bins.isect_slots[i]] = grad;
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
