// Tiles of an image and which of them a splat touches. Index maps and intervals only; who walks them is a schedule.
//
// A splat's tiles are found several times: the projection counts them, and the binning writes that many pairs. So the
// arithmetic that finds them is StrictFloat's, which gives the same bits wherever it is compiled, on CPU and GPU.
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

/// Pixels of a tile that lie in the image.
B3DGS_HD Rect tile_pixels(const TileGrid& grid, std::int32_t tile) {
  const std::int32_t x = tile % grid.columns * grid.tile.width, y = tile / grid.columns * grid.tile.height;
  const std::int32_t x_end = x + grid.tile.width, y_end = y + grid.tile.height;
  return {x, x_end < grid.image_width ? x_end : grid.image_width, y,
          y_end < grid.image_height ? y_end : grid.image_height};
}

/// Pixel (row by row in a tile 16 px wide) of a thread when each warp of 32 owns a sub-tile of 8 x 4 pixels.
B3DGS_HD std::int32_t sub_tile_pixel(std::int32_t thread) {
  const std::int32_t sub_tile = thread / 32, lane = thread % 32;
  const std::int32_t x = sub_tile % 2 * 8 + lane % 8, y = sub_tile / 2 * 4 + lane / 8;
  return y * 16 + x;
}

/// A task of at most 2 x 2 pixels within a tile. Tiles follow one another; within a tile tasks go row by row.
struct TaskPixels {
  std::int32_t tile;
  Rect rect;  // empty where the task lies outside the image
};

B3DGS_HD std::int64_t n_quad_tasks(const TileGrid& grid) {
  const std::int64_t per_tile = std::int64_t{(grid.tile.width + 1) / 2} * ((grid.tile.height + 1) / 2);
  return per_tile * grid.n_tiles();
}

B3DGS_HD TaskPixels quad_task(const TileGrid& grid, std::int64_t task) {
  const std::int32_t columns = (grid.tile.width + 1) / 2, per_tile = columns * ((grid.tile.height + 1) / 2);
  const auto tile = static_cast<std::int32_t>(task / per_tile), quad = static_cast<std::int32_t>(task % per_tile);
  const Rect pixels = tile_pixels(grid, tile);
  const std::int32_t x = pixels.x_begin + quad % columns * 2, y = pixels.y_begin + quad / columns * 2;
  return {tile, {x, x + 2 < pixels.x_end ? x + 2 : pixels.x_end, y, y + 2 < pixels.y_end ? y + 2 : pixels.y_end}};
}

/// Half-open interval of tile columns.
struct TileSpan {
  std::int32_t begin, end;
};

namespace detail {

/// floor to an integer within [low, high]; safe for any finite value.
B3DGS_HD std::int32_t floor_clamped(float value, std::int32_t low, std::int32_t high) {
  if (!(value > static_cast<float>(low))) return low;
  if (!(value < static_cast<float>(high))) return high;
  return static_cast<std::int32_t>(std::floor(value));
}

}  // namespace detail

/// Half width and half height (px) of the smallest upright box around the ellipse alpha >= 1/255, with a margin that
/// covers rounding. `cov` is the 2D covariance; 0 if the opacity itself is below 1/255.
B3DGS_HD Vec2f ellipse_extent(float log2_opacity, const Sym2f& cov) {
  const StrictFloat power = StrictFloat(log2_opacity) - kLog2AlphaMin;  // sigma at the rim, in base 2
  if (!(power >= 0)) return {0, 0};
  const StrictFloat two_sigma = 2 * 0.693147181f * power;
  return {(1.0001f * sqrt(two_sigma * cov.xx) + 1e-3f).value, (1.0001f * sqrt(two_sigma * cov.yy) + 1e-3f).value};
}

namespace detail {

/// Tiles along one axis that hold a pixel centre in [low, high], px.
B3DGS_HD TileSpan tiles_between(StrictFloat low, StrictFloat high, std::int32_t tile_size, std::int32_t n_tiles) {
  const StrictFloat size = static_cast<float>(tile_size);
  return {floor_clamped(((low + 0.5f - size) / size).value, -1, n_tiles - 1) + 1,
          floor_clamped(((high - 0.5f) / size).value, -1, n_tiles - 1) + 1};
}

/// Tiles along one axis that [low, high] overlaps, px.
B3DGS_HD TileSpan tiles_overlapping(StrictFloat low, StrictFloat high, std::int32_t tile_size, std::int32_t n_tiles) {
  const StrictFloat size = static_cast<float>(tile_size);
  return {floor_clamped((low / size).value, 0, n_tiles), -floor_clamped((-high / size).value, -n_tiles, 0)};
}

}  // namespace detail

/// Tiles whose pixel centres the box around a splat's ellipse reaches.
B3DGS_HD Rect box_tiles(const TileGrid& grid, StrictFloat mean_x, StrictFloat mean_y, Vec2f extent) {
  const TileSpan x = detail::tiles_between(mean_x - extent.x, mean_x + extent.x, grid.tile.width, grid.columns);
  const TileSpan y = detail::tiles_between(mean_y - extent.y, mean_y + extent.y, grid.tile.height, grid.rows);
  return {x.begin, x.end, y.begin, y.end};
}

/// Tiles that the square mean +- radius overlaps, as the original rasterizer culls.
B3DGS_HD Rect square_tiles(const TileGrid& grid, StrictFloat mean_x, StrictFloat mean_y, StrictFloat radius) {
  const TileSpan x = detail::tiles_overlapping(mean_x - radius, mean_x + radius, grid.tile.width, grid.columns);
  const TileSpan y = detail::tiles_overlapping(mean_y - radius, mean_y + radius, grid.tile.height, grid.rows);
  return {x.begin, x.end, y.begin, y.end};
}

/// The ellipse alpha >= 1/255 row by row. At height dy above its centre it reaches from
/// shear dy - chord sqrt(1 - (dy / half_height)^2) to the same with plus: no differences of large products, so needles
/// come out as exact as discs.
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
          (1.0001f * sqrt(power / xx) + 1e-3f).value,
          (-xy / yy * extent.x).value};
}

/// Tile columns of one row of tiles that the ellipse touches at some pixel centre: exact but for a margin below 0.01
/// px.
B3DGS_HD TileSpan ellipse_tiles_in_row(const EllipseRows& e, const TileGrid& grid, std::int32_t row) {
  const StrictFloat mean_x = e.mean_x, shear = e.shear, chord = e.chord, height = static_cast<float>(grid.tile.height);
  StrictFloat top = static_cast<float>(row) * height + 0.5f - e.mean_y;  // pixel centres, relative to the mean
  StrictFloat bottom = top + (height - 1);  // in this order, or a row of one pixel could end before it begins
  top = top > -e.half_height ? top : -e.half_height;
  bottom = bottom < e.half_height ? bottom : e.half_height;
  if (top > bottom) return {0, 0};
  // The strip's widest places: the ellipse's rightmost and leftmost points, or the strip's rim nearest to them.
  const StrictFloat right_y = e.right_y < top ? top : (e.right_y > bottom ? bottom : e.right_y);
  const StrictFloat left_y = -e.right_y < top ? top : (-e.right_y > bottom ? bottom : -e.right_y);
  const StrictFloat right_v = right_y / e.half_height, left_v = left_y / e.half_height;
  const StrictFloat right_square = 1 - right_v * right_v, left_square = 1 - left_v * left_v;
  StrictFloat right = shear * right_y + chord * sqrt(right_square > 0 ? right_square : 0);
  StrictFloat left = shear * left_y - chord * sqrt(left_square > 0 ? left_square : 0);
  right = (right < e.half_width ? right : e.half_width) + 5e-3f;
  left = (left > -e.half_width ? left : -e.half_width) - 5e-3f;
  return detail::tiles_between(mean_x + left, mean_x + right, grid.tile.width, grid.columns);
}

/// Rows of tiles that a splat may touch, and the columns it touches in each.
struct TileRows {
  Culling culling;
  std::int32_t begin, end;  // half-open
  TileSpan square;          // the columns of all rows, if culling is kSquare
  EllipseRows ellipse;      // else
  /// Empty where the ellipse misses the row.
  B3DGS_HD TileSpan span(const TileGrid& grid, std::int32_t row) const {
    return culling == Culling::kSquare ? square : ellipse_tiles_in_row(ellipse, grid, row);
  }
};

B3DGS_HD TileRows tile_rows(const TileGrid& grid, Culling culling, const Splat& splat, Vec2f extent,
                            std::int32_t radius) {
  if (culling == Culling::kSquare) {
    const Rect tiles = square_tiles(grid, splat.mean_x, splat.mean_y, static_cast<float>(radius));
    return {culling, tiles.y_begin, tiles.y_end, {tiles.x_begin, tiles.x_end}, {}};
  }
  const Rect tiles = box_tiles(grid, splat.mean_x, splat.mean_y, extent);
  return {culling, tiles.y_begin, tiles.y_end, {}, make_ellipse_rows(splat, extent)};
}

/// Whether tiles_touched() counts all tiles, or ends at the first row in which there are any.
enum class TileCount { kAll, kAny };

/// How many tiles a splat touches. A Gaussian that touches none is not seen.
template <TileCount kCount = TileCount::kAll>
B3DGS_HD std::int32_t tiles_touched(const TileGrid& grid, Culling culling, const Splat& splat, Vec2f extent,
                                    std::int32_t radius) {
  const TileRows rows = tile_rows(grid, culling, splat, extent, radius);
  std::int32_t n_tiles = 0;
  for (std::int32_t row = rows.begin; row < rows.end; ++row) {
    const TileSpan span = rows.span(grid, row);
    if (span.begin < span.end) n_tiles += span.end - span.begin;
    if (kCount == TileCount::kAny && n_tiles > 0) break;
  }
  return n_tiles;
}

/// Calls visit(row, span) for each row of tiles in which the splat touches tiles.
template <class Visit>
B3DGS_HD void visit_tile_rows(const TileGrid& grid, Culling culling, const Splat& splat, Vec2f extent,
                              std::int32_t radius, Visit&& visit) {
  const TileRows rows = tile_rows(grid, culling, splat, extent, radius);
  for (std::int32_t row = rows.begin; row < rows.end; ++row) {
    const TileSpan span = rows.span(grid, row);
    if (span.begin < span.end) visit(row, span);
  }
}

}  // namespace b3dgs
