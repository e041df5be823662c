// Sums over the pixels of a tile for each splat of its list: the backward blend, which visits the splats back to front,
// and scoring, front to back. Threads take tiles from an atomic counter, and SIMD lanes are pixels. The sums of a
// (tile, splat) pair stay in registers and are written once, to the pair's slot. So nothing is stored per pixel and
// splat, and no two threads write to the same address.

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "raster/cpu/pair_sums.cpp"
#include <hwy/foreach_target.h>
// Everything below is compiled once per instruction set.
#include "raster/cpu/forward/lanes-inl.h"
// Include after lanes-inl.h, because it computes on that SIMD type.
#include "raster/math/blend.h"

#include <algorithm>

#include "core/parallel.h"
#include "raster/cpu/passes.h"
#include "raster/math/pixel_outputs.h"
#include "raster/math/tiling.h"

HWY_BEFORE_NAMESPACE();
namespace b3dgs {
namespace HWY_NAMESPACE {
namespace {

/// A tile in the backward blend. Padding pixels have no last splat and no gradient.
struct TileGradients : TileLayout {
  HWY_ALIGN float transmittance[kCapacity], behind[kCapacity];  // ReverseState
  HWY_ALIGN float red[kCapacity], green[kCapacity], blue[kCapacity], depth[kCapacity];
  HWY_ALIGN std::int32_t last[kCapacity];
  std::int32_t row_last[cpu::kMaxTileSide];  // largest `last` of each row
  std::int32_t tile_last = -1;               // and of the tile

  HWY_INLINE TileGradients(const BlendBackwardArgs& args, std::int64_t tile) : TileLayout(args.grid, tile) {
    const int n = rows * stride;
    for (float* plane : {behind, red, green, blue, depth}) std::fill(plane, plane + n, 0.0f);
    std::fill(transmittance, transmittance + n, 1.0f);
    std::fill(last, last + n, -1);
    for (int row = 0; row < rows; ++row) {
      row_last[row] = -1;
      for (int column = 0; column < columns; ++column) {
        load_pixel(args, row * stride + column, pixel(row, column));
        row_last[row] = std::max(row_last[row], last[row * stride + column]);
      }
      tile_last = std::max(tile_last, row_last[row]);
    }
  }

  void load_pixel(const BlendBackwardArgs& args, int p, std::int64_t pixel) {
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

/// A SplatGrad spread over lanes until the last row is done.
struct SplatGradLanes {
  Lanes log_alpha, mean_x, mean_y, cov_xx, cov_xy, cov_yy;
  Lanes red, green, blue;
  Lanes depth;
};

/// Returns the gradient of the splat at `position` of the list, summed over `vectors` of `rows`.
template <bool kDepth>
HWY_INLINE SplatGrad backward_onto(TileGradients& tile, const Splat& splat, const Span& rows, const Span& vectors,
                                   std::int32_t position) {
  const auto shape = splat_shape<Lanes>(splat);
  const Lanes red(splat.red), green(splat.green), blue(splat.blue), depth(splat.depth);
  const IntTag di;
  const IntVec splat_position = hn::Set(di, position);
  const Lanes zero(0.0f);
  SplatGradLanes sums{zero, zero, zero, zero, zero, zero, zero, zero, zero, zero};
  bool any = false;
  for (int v = vectors.begin; v < vectors.end; ++v) {
    const Lanes pixel_x = tile.center_x(v * lane_count());
    for (int row = rows.begin; row < rows.end; ++row) {
      if (tile.row_last[row] < position) continue;
      const Footprint<Lanes> footprint = evaluate_footprint(shape, pixel_x, tile.center_y(row));
      const int p = row * tile.stride + v * lane_count();
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
  if (!any) return {};
  return {sums.log_alpha.sum(), sums.mean_x.sum(), sums.mean_y.sum(), sums.cov_xx.sum(), sums.cov_xy.sum(),
          sums.cov_yy.sum(),    sums.red.sum(),    sums.green.sum(),  sums.blue.sum(),   kDepth ? sums.depth.sum() : 0};
}

/// A tile during scoring. Padding pixels count as finished.
struct TileErrors : TileLayout {
  HWY_ALIGN float transmittance[kCapacity];  // as in PixelState
  HWY_ALIGN float error[kCapacity];

  HWY_INLINE TileErrors(const ScoreArgs& args, std::int64_t tile) : TileLayout(args.grid, tile) {
    std::fill(transmittance, transmittance + rows * stride, kClosedPixel);
    std::fill(error, error + rows * stride, 0.0f);
    for (int row = 0; row < rows; ++row) {
      for (int column = 0; column < columns; ++column) {
        transmittance[row * stride + column] = 1;
        error[row * stride + column] = clamp_error(args.error[pixel(row, column)]);
      }
    }
  }

  bool is_finished() const {
    return std::all_of(transmittance, transmittance + rows * stride, [](float t) { return t < 0; });
  }
};

/// Returns the sum over lanes, in units of scores.
HWY_INLINE std::uint64_t units_of(Lanes value) {
  static_assert(std::int64_t{kMaxLanes} * kScoreMax < std::int64_t{1} << 31, "a vector's sum fits into 32 bits");
  const IntVec units = hn::ConvertTo(IntTag(), (value * Lanes(kScoreUnits) + Lanes(0.5f)).v);
  return static_cast<std::uint64_t>(hn::GetLane(hn::SumOfLanes(IntTag(), units)));
}

/// Advances the pixels of `vectors` of `rows` by one splat, and returns the sums.
HWY_INLINE ScoreSums score_rows(TileErrors& tile, const Splat& splat, const Span& rows, const Span& vectors) {
  const auto shape = splat_shape<Lanes>(splat);
  ScoreSums sums{0, 0, 0};
  for (int row = rows.begin; row < rows.end; ++row) {
    const Lanes pixel_y = tile.center_y(row);
    for (int v = vectors.begin; v < vectors.end; ++v) {
      const Footprint<Lanes> footprint = evaluate_footprint(shape, tile.center_x(v * lane_count()), pixel_y);
      if (none(footprint.contributes)) continue;
      const int p = row * tile.stride + v * lane_count();
      Lanes transmittance = Lanes::load(tile.transmittance + p);
      const Lanes weight =
          blend_weight_over(transmittance, footprint.contributes, evaluate_alpha(footprint.power).alpha);
      transmittance.store(tile.transmittance + p);
      sums.weight += units_of(weight);
      sums.error += units_of(weight * weight * Lanes::load(tile.error + p));
      sums.max_weight = std::max(sums.max_weight, hn::GetLane(hn::MaxOfLanes(FloatTag(), weight.v)));
    }
  }
  return sums;
}

}  // namespace

void run_blend_backward(const BlendBackwardArgs& args, std::int64_t index) {
  constexpr std::int64_t kPrefetch = 16;  // entries to prefetch
  TileGradients tile(args, index);
  const std::int64_t first = args.bins.tile_offsets[index], last = args.bins.tile_offsets[index + 1];
  for (std::int64_t i = last - 1; i >= first; --i) {
    const std::int64_t ahead = std::max(i - kPrefetch, first);
    cpu::prefetch_object(args.splats[args.bins.splat_ids[ahead]]);
    cpu::prefetch_object(args.extents[args.bins.splat_ids[ahead]]);
    cpu::prefetch_object(args.pair_grads[args.bins.pair_slots[ahead]]);
    SplatGrad grad{};
    const auto position = static_cast<std::int32_t>(i - first);
    if (position <= tile.tile_last) {
      const std::int32_t id = args.bins.splat_ids[i];
      const Splat& splat = args.splats[id];
      const Span rows = tile.rows_reached(splat, args.extents[id], 0, tile.rows);
      const Span vectors = tile.vectors_reached(splat, args.extents[id]);
      grad = args.grad.depth != nullptr ? backward_onto<true>(tile, splat, rows, vectors, position)
                                        : backward_onto<false>(tile, splat, rows, vectors, position);
    }
    args.pair_grads[args.bins.pair_slots[i]] = grad;
  }
}

void run_score(const ScoreArgs& args, std::int64_t index) {
  constexpr std::int64_t kCheckInterval = 32;  // entries between tests whether all pixels are finished
  TileErrors tile(args, index);
  const std::int64_t first = args.bins.tile_offsets[index], last = args.bins.tile_offsets[index + 1];
  bool is_finished = false;
  for (std::int64_t i = first; i < last; ++i) {
    ScoreSums sums{0, 0, 0};
    if ((i - first) % kCheckInterval == 0 && !is_finished) is_finished = tile.is_finished();
    if (!is_finished) {
      const std::int32_t id = args.bins.splat_ids[i];
      const Splat& splat = args.splats[id];
      sums = score_rows(tile, splat, tile.rows_reached(splat, args.extents[id], 0, tile.rows),
                        tile.vectors_reached(splat, args.extents[id]));
    }
    args.sums[args.bins.pair_slots[i]] = sums;
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace b3dgs
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace b3dgs {
HWY_EXPORT(run_blend_backward);
HWY_EXPORT(run_score);

namespace cpu {

void blend_backward(const BlendBackwardArgs& args) {
  parallel_pool(args.grid.n_tiles(), [&](std::int64_t tile, int) {
    HWY_DYNAMIC_DISPATCH(run_blend_backward)(args, tile);
  });
}

void score(const ScoreArgs& args) {
  parallel_pool(args.grid.n_tiles(), [&](std::int64_t tile, int) { HWY_DYNAMIC_DISPATCH(run_score)(args, tile); });
}

}  // namespace cpu
}  // namespace b3dgs
#endif
