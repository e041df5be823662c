// Tiles of an image, and the tiles that a splat touches. Index arithmetic and intervals, no schedules.
//
// The tiles of a splat are computed more than once: projection counts them, and binning writes that many pairs. The two
// must agree exactly, so the arithmetic uses StrictFloat, which gives the same bits in every kernel, on CPU and GPU.
#pragma once

#include <cmath>
#include <cstdint>

#include "core/strict_float.h"
#include "core/vec.h"
#include "raster/args.h"
#include "raster/constants.h"

namespace b3dgs {

B3DGS_HD TileGrid make_tile_grid(std::int32_t image_width, std::int32_t image_height, TileShape tile) {
  return {image_width, image_height, tile, (image_width + tile.width - 1) / tile.width,
          (image_height + tile.height - 1) / tile.height};
}

/// Half-open rectangle of pixels or of tiles.
struct Rect {
  std::int32_t x_begin, x_end, y_begin, y_end;
  B3DGS_HD bool empty() const { return x_begin >= x_end || y_begin >= y_end; }
};

/// Returns the pixels of a tile, cut off at the edge of the image.
B3DGS_HD Rect tile_pixels(const TileGrid& grid, std::int32_t tile) {
  const std::int32_t x = tile % grid.columns * grid.tile.width, y = tile / grid.columns * grid.tile.height;
  const std::int32_t x_end = x + grid.tile.width, y_end = y + grid.tile.height;
  return {x, x_end < grid.image_width ? x_end : grid.image_width, y,
          y_end < grid.image_height ? y_end : grid.image_height};
}

/// Width and height of the tiles of our own CUDA kernels, px.
inline constexpr std::int32_t kCudaTileSide = 16, kCudaTilePixels = kCudaTileSide * kCudaTileSide;

/// A sub-tile is the part of a CUDA tile that one warp blends, a pixel per lane. 8 x 4 has a smaller perimeter than 16
/// x 2, so fewer splats reach it.
inline constexpr std::int32_t kSubTileWidth = 8, kSubTileHeight = 4;
inline constexpr std::int32_t kSubTilePixels = kSubTileWidth * kSubTileHeight;
static_assert(kSubTilePixels == 32, "a lane of a warp per pixel");

/// Returns the index within its tile (row by row, 16 px wide in both families) of the pixel that a thread blends if
/// warp w has sub-tile w.
B3DGS_HD std::int32_t sub_tile_pixel(std::int32_t thread) {
  constexpr std::int32_t kColumns = kCudaTileSide / kSubTileWidth;
  const std::int32_t sub_tile = thread / kSubTilePixels, lane = thread % kSubTilePixels;
  const std::int32_t x = sub_tile % kColumns * kSubTileWidth + lane % kSubTileWidth;
  const std::int32_t y = sub_tile / kColumns * kSubTileHeight + lane / kSubTileWidth;
  return y * kCudaTileSide + x;
}

/// A quad is a task of `combined`: 2 x 2 pixels of a patch.
inline constexpr std::int32_t kQuadSide = 2, kQuadPixels = kQuadSide * kQuadSide;

/// Half-open interval of rows or columns, of tiles or pixels.
struct Span {
  std::int32_t begin, end;
  B3DGS_HD bool empty() const { return begin >= end; }
};

namespace detail {

/// Returns floor(value), clamped to [low, high] before the conversion to an integer, which overflows for large values.
B3DGS_HD std::int32_t floor_clamped(float value, std::int32_t low, std::int32_t high) {
  if (!(value > static_cast<float>(low))) return low;
  if (!(value < static_cast<float>(high))) return high;
#if defined(__CUDA_ARCH__)
  return static_cast<std::int32_t>(std::floor(value));
#else
  // std::floor() would be a function call, because builds target every x86-64.
  const auto truncated = static_cast<std::int32_t>(value);
  return truncated - (static_cast<float>(truncated) > value);
#endif
}

/// Returns 1 / side, 1/px. The tile sides are powers of two, so multiplying by it gives the same bits as dividing.
B3DGS_HD StrictFloat inverse_side(std::int32_t side) {
  return side == 16 ? 0.0625f : side == 8 ? 0.125f : 1.0f / static_cast<float>(side);
}

/// Returns the tiles along one axis with a pixel centre in [low, high], px.
B3DGS_HD Span tiles_between(StrictFloat low, StrictFloat high, std::int32_t tile_size, std::int32_t n_tiles) {
  const StrictFloat size = static_cast<float>(tile_size), inverse = inverse_side(tile_size);
  return {floor_clamped(((low + 0.5f - size) * inverse).value, -1, n_tiles - 1) + 1,
          floor_clamped(((high - 0.5f) * inverse).value, -1, n_tiles - 1) + 1};
}

/// Returns the tiles along one axis that overlap [low, high], px.
B3DGS_HD Span tiles_overlapping(StrictFloat low, StrictFloat high, std::int32_t tile_size, std::int32_t n_tiles) {
  const StrictFloat inverse = inverse_side(tile_size);
  return {floor_clamped((low * inverse).value, 0, n_tiles), -floor_clamped((-high * inverse).value, -n_tiles, 0)};
}

}  // namespace detail

// Margins by which ellipses are enlarged, so that rounding never excludes a tile with a contributing pixel.
inline constexpr float kExtentScale = 1.0001f;  // relative part, on lengths
inline constexpr float kExtentMargin = 1e-3f;   // px, absolute part
inline constexpr float kTileRowMargin = 5e-3f;  // px, for the left and right ends computed for one row of tiles
inline constexpr float kLn2 = 0.693147181f;

/// Returns the half width and half height (px) of the axis-aligned bounding box of the ellipse where alpha >= 1/255,
/// slightly enlarged. Returns {0, 0} if the opacity itself is below 1/255. `cov` is the 2D covariance, px^2.
B3DGS_HD Vec2f ellipse_extent(float log2_opacity, const Sym2f& cov) {
  const StrictFloat power = StrictFloat(log2_opacity) - kLog2AlphaMin;  // log2 of opacity / (1/255)
  if (!(power >= 0)) return {0, 0};
  const StrictFloat two_sigma = 2 * kLn2 * power;  // d^T cov^-1 d on the ellipse
  return {(kExtentScale * sqrt(two_sigma * cov.xx) + kExtentMargin).value,
          (kExtentScale * sqrt(two_sigma * cov.yy) + kExtentMargin).value};
}

/// The ellipse where alpha >= 1/255, row by row. At height dy relative to its centre it spans
///   dx = shear dy +- chord sqrt(1 - (dy / half_height)^2).
/// No term is a difference of large products, so this is as accurate for needles as for discs.
struct EllipseRows {
  float mean_x, mean_y;  // px
  float half_width, half_height;
  float shear;    // dx per dy of the chord's midpoint
  float chord;    // half the chord through the centre, px
  float right_y;  // dy of the rightmost point
};

B3DGS_HD EllipseRows make_ellipse_rows(const Splat& splat, Vec2f extent) {
  const StrictFloat power = StrictFloat(splat.log2_opacity) - kLog2AlphaMin;
  const StrictFloat xx = splat.conic_xx, xy = splat.conic_xy, yy = splat.conic_yy;
  return {splat.mean_x,
          splat.mean_y,
          extent.x,
          extent.y,
          (-xy / xx).value,
          (kExtentScale * sqrt(power / xx) + kExtentMargin).value,
          (-xy / yy * extent.x).value};
}

/// Returns the columns of tiles in one row whose pixel centres the ellipse reaches, exact up to a margin below 0.01 px.
B3DGS_HD Span ellipse_tiles_in_row(const EllipseRows& e, const TileGrid& grid, std::int32_t row) {
  const StrictFloat mean_x = e.mean_x, shear = e.shear, chord = e.chord, height = static_cast<float>(grid.tile.height);
  StrictFloat top = static_cast<float>(row) * height + 0.5f - e.mean_y;  // pixel centres, relative to the mean
  StrictFloat bottom = top + (height - 1);  // not from `row`, so that a row of one pixel does not end before it begins
  top = top > -e.half_height ? top : -e.half_height;
  bottom = bottom < e.half_height ? bottom : e.half_height;
  if (top > bottom) return {0, 0};
  // Within the strip [top, bottom], the ellipse is widest at its rightmost and leftmost points, or at the edge of the
  // strip nearest to them.
  const StrictFloat right_y = e.right_y < top ? top : (e.right_y > bottom ? bottom : e.right_y);
  const StrictFloat left_y = -e.right_y < top ? top : (-e.right_y > bottom ? bottom : -e.right_y);
  const StrictFloat right_v = right_y / e.half_height, left_v = left_y / e.half_height;
  const StrictFloat right_square = 1 - right_v * right_v, left_square = 1 - left_v * left_v;
  StrictFloat right = shear * right_y + chord * sqrt(right_square > 0 ? right_square : 0);
  StrictFloat left = shear * left_y - chord * sqrt(left_square > 0 ? left_square : 0);
  right = (right < e.half_width ? right : e.half_width) + kTileRowMargin;
  left = (left > -e.half_width ? left : -e.half_width) - kTileRowMargin;
  return detail::tiles_between(mean_x + left, mean_x + right, grid.tile.width, grid.columns);
}

/// The rows of tiles that a splat may touch, and the columns that it touches in each.
struct TileRows {
  Culling culling;
  std::int32_t begin, end;  // half-open
  Span square;              // columns, the same in all rows; for kSquare
  EllipseRows ellipse;      // for kEllipse
  /// Returns the columns touched in `row`, empty where the ellipse misses the row.
  B3DGS_HD Span span(const TileGrid& grid, std::int32_t row) const {
    return culling == Culling::kSquare ? square : ellipse_tiles_in_row(ellipse, grid, row);
  }
};

/// kSquare: all tiles that overlap the square mean +- radius, as in the original rasterizer. kEllipse: the tiles with a
/// pixel centre in the ellipse's bounding box that the ellipse reaches.
B3DGS_HD TileRows tile_rows(const TileGrid& grid, Culling culling, const Splat& splat, Vec2f extent,
                            std::int32_t radius) {
  const StrictFloat mean_x = splat.mean_x, mean_y = splat.mean_y, side = static_cast<float>(radius);
  if (culling == Culling::kSquare) {
    const Span x = detail::tiles_overlapping(mean_x - side, mean_x + side, grid.tile.width, grid.columns);
    const Span y = detail::tiles_overlapping(mean_y - side, mean_y + side, grid.tile.height, grid.rows);
    return {culling, y.begin, y.end, x, {}};
  }
  const Span y = detail::tiles_between(mean_y - extent.y, mean_y + extent.y, grid.tile.height, grid.rows);
  return {culling, y.begin, y.end, {}, make_ellipse_rows(splat, extent)};
}

/// Returns the empty rows of a splat that touches no tile.
B3DGS_HD TileRows no_tile_rows(Culling culling) {
  return {culling, 0, 0, {0, 0}, {}};
}

/// Calls visit(row, span) for each row of tiles in which the splat touches tiles.
template <class Visit>
B3DGS_HD void visit_tile_rows(const TileGrid& grid, Culling culling, const Splat& splat, Vec2f extent,
                              std::int32_t radius, Visit&& visit) {
  const TileRows rows = tile_rows(grid, culling, splat, extent, radius);
  for (std::int32_t row = rows.begin; row < rows.end; ++row) {
    const Span span = rows.span(grid, row);
    if (!span.empty()) visit(row, span);
  }
}

/// Returns the number of tiles that the splat touches.
B3DGS_HD std::int32_t tiles_touched(const TileGrid& grid, Culling culling, const Splat& splat, Vec2f extent,
                                    std::int32_t radius) {
  const TileRows rows = tile_rows(grid, culling, splat, extent, radius);
  std::int32_t n_tiles = 0;
  for (std::int32_t row = rows.begin; row < rows.end; ++row) {
    const Span span = rows.span(grid, row);
    if (!span.empty()) n_tiles += span.end - span.begin;
  }
  return n_tiles;
}

/// Returns whether the splat touches any tile. If not, its Gaussian is not visible.
B3DGS_HD bool touches_tiles(const TileGrid& grid, Culling culling, const Splat& splat, Vec2f extent,
                            std::int32_t radius) {
  const TileRows rows = tile_rows(grid, culling, splat, extent, radius);
  for (std::int32_t row = rows.begin; row < rows.end; ++row) {
    if (!rows.span(grid, row).empty()) return true;
  }
  return false;
}

/// Returns the rows of [low, high) with a pixel centre within `extent` of `mean`, counted from pixel row `first` of the
/// image. Works for columns too.
B3DGS_HD Span pixels_reached(float mean, float extent, float first, std::int32_t low, std::int32_t high) {
  const float middle = mean - first - 0.5f;
  return {detail::floor_clamped(middle - extent, low - 1, high) + 1,
          detail::floor_clamped(middle + extent, low - 1, high - 1) + 1};
}

}  // namespace b3dgs
