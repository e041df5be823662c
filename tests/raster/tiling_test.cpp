#include "raster/math/tiling.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

namespace b3dgs {
namespace {

struct Size {
  std::int32_t width, height;
};
const std::vector<Size> kImages{{1, 1}, {16, 16}, {17, 15}, {48, 32}, {37, 29}, {5, 70}, {33, 8}};
const std::vector<TileShape> kTiles{{16, 16}, {16, 8}, {1, 1}, {5, 3}, {32, 32}};

/// Calls check(grid) for every image with every tile shape.
template <class Check>
void for_all_grids(Check&& check) {
  for (const Size& image : kImages) {
    for (const TileShape& tile : kTiles) {
      SCOPED_TRACE(testing::Message() << image.width << " x " << image.height << " px in tiles of " << tile.width
                                      << " x " << tile.height);
      check(make_tile_grid(image.width, image.height, tile));
    }
  }
}

TEST(Tiling, TilesCoverEachPixelOnce) {
  for_all_grids([](const TileGrid& grid) {
    std::vector<int> visits(static_cast<std::size_t>(grid.image_width * grid.image_height));
    for (std::int32_t tile = 0; tile < grid.n_tiles(); ++tile) {
      const Rect rect = tile_pixels(grid, tile);
      EXPECT_FALSE(rect.empty());
      EXPECT_EQ(rect.x_begin, tile % grid.columns * grid.tile.width);
      EXPECT_EQ(rect.y_begin, tile / grid.columns * grid.tile.height);
      for (std::int32_t y = rect.y_begin; y < rect.y_end; ++y) {
        for (std::int32_t x = rect.x_begin; x < rect.x_end; ++x) ++visits.at(y * grid.image_width + x);
      }
    }
    EXPECT_EQ(std::count(visits.begin(), visits.end(), 1), static_cast<std::ptrdiff_t>(visits.size()));
  });
}

TEST(Tiling, SubTilesCoverATileOnceInBlocksOfEightByFour) {
  for (const std::int32_t n_threads : {128, 256}) {
    std::vector<int> visits(static_cast<std::size_t>(n_threads));
    for (std::int32_t thread = 0; thread < n_threads; ++thread) {
      const std::int32_t pixel = sub_tile_pixel(thread), first = sub_tile_pixel(thread / 32 * 32);
      ++visits.at(static_cast<std::size_t>(pixel));
      EXPECT_LT(pixel % 16 - first % 16, 8);
      EXPECT_GE(pixel % 16, first % 16);
      EXPECT_LT(pixel / 16 - first / 16, 4);
      EXPECT_GE(pixel / 16, first / 16);
    }
    EXPECT_EQ(std::count(visits.begin(), visits.end(), 1), n_threads);
  }
}

/// A splat with its covariance, as computed by projection.
struct Ellipse {
  double mean_x, mean_y, xx, xy, yy, opacity;

  double determinant() const { return xx * yy - xy * xy; }
  double sigma(double x, double y) const {
    const double dx = x - mean_x, dy = y - mean_y;
    return 0.5 * (yy * dx * dx - 2 * xy * dx * dy + xx * dy * dy) / determinant();
  }
  /// Returns sigma at the rim, where alpha is 1/255.
  double rim() const { return std::log(opacity * 255); }

  Splat splat() const {
    const double half = 0.5 / std::log(2.0) / determinant();
    Splat splat{};
    splat.mean_x = static_cast<float>(mean_x);
    splat.mean_y = static_cast<float>(mean_y);
    splat.log2_opacity = static_cast<float>(std::log2(opacity));
    splat.conic_xx = static_cast<float>(half * yy);
    splat.conic_xy = static_cast<float>(-half * xy);
    splat.conic_yy = static_cast<float>(half * xx);
    return splat;
  }
  Sym2f covariance() const { return {static_cast<float>(xx), static_cast<float>(xy), static_cast<float>(yy)}; }
  std::int32_t radius() const {
    const double longer = (xx + yy) / 2 + std::sqrt((xx - yy) * (xx - yy) / 4 + xy * xy);
    return static_cast<std::int32_t>(std::ceil(3 * std::sqrt(longer)));
  }
};

Ellipse make_ellipse(double x, double y, double sigma_1, double sigma_2, double angle, double opacity) {
  const double a = sigma_1 * sigma_1, b = sigma_2 * sigma_2, c = std::cos(angle), s = std::sin(angle);
  // The means are rounded to float, so that the test and the code use the same ellipse.
  return {static_cast<float>(x), static_cast<float>(y),       a * c * c + b * s * s + 0.3,
          (a - b) * c * s,       a * s * s + b * c * c + 0.3, opacity};
}

std::vector<Ellipse> random_ellipses(const TileGrid& grid, int n) {
  std::mt19937 engine(31);
  const auto uniform = [&](double low, double high) { return low + (high - low) * engine() / 4294967296.0; };
  std::vector<Ellipse> ellipses;
  for (int i = 0; i < n; ++i) {
    const double x = uniform(-20, grid.image_width + 20), y = uniform(-20, grid.image_height + 20);
    const double sigma_1 = std::exp(uniform(-4, 4)), sigma_2 = i % 3 == 0 ? 0.01 : std::exp(uniform(-4, 3));
    const double angle = i % 5 == 0 ? M_PI / 4 * (i % 8) : uniform(0, M_PI);
    const double opacity = i % 2 == 0 ? uniform(0.00393, 0.02) : uniform(0.02, 1);
    ellipses.push_back(make_ellipse(x, y, sigma_1, sigma_2, angle, opacity));
  }
  return ellipses;
}

/// Returns the tiles that visit_tile_rows() visits, and checks that it visits none twice.
std::vector<bool> visited_tiles(const TileGrid& grid, Culling culling, const Ellipse& ellipse) {
  std::vector<bool> visited(static_cast<std::size_t>(grid.n_tiles()));
  const Splat splat = ellipse.splat();
  const Vec2f extent = ellipse_extent(splat.log2_opacity, ellipse.covariance());
  visit_tile_rows(grid, culling, splat, extent, ellipse.radius(), [&](std::int32_t row, Span span) {
    EXPECT_GE(row, 0);
    EXPECT_LT(row, grid.rows);
    EXPECT_GE(span.begin, 0);
    EXPECT_LE(span.end, grid.columns);
    for (std::int32_t column = span.begin; column < span.end; ++column) {
      const auto tile = static_cast<std::size_t>(row * grid.columns + column);
      EXPECT_FALSE(visited.at(tile)) << "tile " << tile << " is visited twice";
      visited.at(tile) = true;
    }
  });
  return visited;
}

bool has_pixel_inside(const Ellipse& ellipse, const Rect& rect) {
  for (std::int32_t y = rect.y_begin; y < rect.y_end; ++y) {
    for (std::int32_t x = rect.x_begin; x < rect.x_end; ++x) {
      if (ellipse.sigma(x + 0.5, y + 0.5) <= ellipse.rim()) return true;
    }
  }
  return false;
}

/// Returns the exact smallest sigma over a rectangle: that at the centre if it is inside, otherwise that on an edge.
double least_sigma(const Ellipse& e, double x_low, double x_high, double y_low, double y_high) {
  if (x_low <= e.mean_x && e.mean_x <= x_high && y_low <= e.mean_y && e.mean_y <= y_high) return 0;
  double least = INFINITY;
  for (double x : {x_low, x_high}) {
    const double y = e.mean_y + e.xy / e.xx * (x - e.mean_x);  // nearest on the whole line
    least = std::min(least, e.sigma(x, std::clamp(y, y_low, y_high)));
  }
  for (double y : {y_low, y_high}) {
    const double x = e.mean_x + e.xy / e.yy * (y - e.mean_y);
    least = std::min(least, e.sigma(std::clamp(x, x_low, x_high), y));
  }
  return least;
}

TEST(Tiling, EllipseVisitsEveryTileWithAVisiblePixel) {
  for (const TileShape& tile : kTiles) {
    const TileGrid grid = make_tile_grid(75, 59, tile);
    int n_visible = 0;
    for (const Ellipse& ellipse : random_ellipses(grid, 1500)) {
      const std::vector<bool> visited = visited_tiles(grid, Culling::kEllipse, ellipse);
      for (std::int32_t t = 0; t < grid.n_tiles(); ++t) {
        const bool visible = has_pixel_inside(ellipse, tile_pixels(grid, t));
        n_visible += visible;
        ASSERT_TRUE(visited[static_cast<std::size_t>(t)] || !visible)
            << "tile " << t << " of " << tile.width << " x " << tile.height << ", ellipse at (" << ellipse.mean_x
            << ", " << ellipse.mean_y << "), covariance (" << ellipse.xx << ", " << ellipse.xy << ", " << ellipse.yy
            << "), opacity " << ellipse.opacity;
      }
    }
    EXPECT_GT(n_visible, 1000);
  }
}

TEST(Tiling, EllipseVisitsNoTileWhosePixelCentresItClearlyMisses) {
  for (const TileShape& tile : kTiles) {
    const TileGrid grid = make_tile_grid(75, 59, tile);
    int n_visited = 0, n_beyond = 0;
    for (const Ellipse& ellipse : random_ellipses(grid, 1500)) {
      const std::vector<bool> visited = visited_tiles(grid, Culling::kEllipse, ellipse);
      // A hundredth of a pixel, plus rounding errors for ellipses of hundreds of pixels.
      const double size = std::sqrt(2 * ellipse.rim() * (ellipse.xx + ellipse.yy));
      const double margin = 0.01 + 2e-4 * size;
      for (std::int32_t t = 0; t < grid.n_tiles(); ++t) {
        if (!visited[static_cast<std::size_t>(t)]) continue;
        // The hull of the tile's pixel centres, including those outside the image.
        const double x = t % grid.columns * tile.width + 0.5, y = t / grid.columns * tile.height + 0.5;
        const bool touches = least_sigma(ellipse, x - margin, x + tile.width - 1 + margin, y - margin,
                                         y + tile.height - 1 + margin) <= ellipse.rim();
        ++n_visited;
        n_beyond += !touches;
      }
    }
    EXPECT_EQ(n_beyond, 0) << "of " << n_visited << " with tiles of " << tile.width << " x " << tile.height;
  }
}

TEST(Tiling, EllipseThatJustReachesAPixelCentreVisitsItsTile) {
  // The rim passes through the pixel centre nearest to the splat in the neighbouring tile, within rounding.
  const TileGrid grid = make_tile_grid(48, 48, {16, 16});
  const double opacity = 0.5, rim = std::log(0.5 * 255);
  const std::size_t middle = 4;  // of 3 x 3 tiles: pixels 16 to 31, centres 16.5 to 31.5
  for (double along : {16.5, 20.5, 31.5}) {
    for (double gap : {2.5, 3.25, 7.5, 12.0, 40.0}) {
      const double variance = gap * gap / (2 * rim) * (1 + 1e-6);
      const auto reaches_middle = [&](double x, double y) {
        return bool{visited_tiles(grid, Culling::kEllipse, {x, y, variance, 0, variance, opacity})[middle]};
      };
      EXPECT_TRUE(reaches_middle(16.5 - gap, along)) << along << ", " << gap;
      EXPECT_TRUE(reaches_middle(31.5 + gap, along)) << along << ", " << gap;
      EXPECT_TRUE(reaches_middle(along, 16.5 - gap)) << along << ", " << gap;
      EXPECT_TRUE(reaches_middle(along, 31.5 + gap)) << along << ", " << gap;
    }
  }
}

TEST(Tiling, EllipseBelowTheCutoffHasNoExtent) {
  const Vec2f extent = ellipse_extent(std::log2(0.0039f), {4, 0, 4});
  EXPECT_EQ(extent.x, 0);
  EXPECT_EQ(extent.y, 0);
}

TEST(Tiling, SquareVisitsTheTilesItOverlaps) {
  for (const TileShape& tile : kTiles) {
    const TileGrid grid = make_tile_grid(75, 59, tile);
    for (const Ellipse& ellipse : random_ellipses(grid, 500)) {
      const std::vector<bool> visited = visited_tiles(grid, Culling::kSquare, ellipse);
      const double r = ellipse.radius();
      for (std::int32_t t = 0; t < grid.n_tiles(); ++t) {
        const double x = t % grid.columns, y = t / grid.columns;
        const bool overlaps =
            x >= std::floor((ellipse.mean_x - r) / tile.width) && x < std::ceil((ellipse.mean_x + r) / tile.width) &&
            y >= std::floor((ellipse.mean_y - r) / tile.height) && y < std::ceil((ellipse.mean_y + r) / tile.height);
        ASSERT_EQ(visited[static_cast<std::size_t>(t)], overlaps)
            << "tile " << t << " of " << tile.width << " x " << tile.height << ", square at (" << ellipse.mean_x << ", "
            << ellipse.mean_y << ") +- " << r;
      }
    }
  }
}

TEST(Tiling, SplatsFarOutsideVisitNothing) {
  const TileGrid grid = make_tile_grid(48, 48, {16, 16});
  for (double far : {1e3, 1e9, 3e38}) {
    for (Culling culling : {Culling::kEllipse, Culling::kSquare}) {
      for (const Ellipse& ellipse : {Ellipse{far, 20, 4, 0, 4, 0.9}, Ellipse{-far, 20, 4, 0, 4, 0.9},
                                     Ellipse{20, far, 4, 0, 4, 0.9}, Ellipse{20, -far, 4, 0, 4, 0.9}}) {
        const std::vector<bool> visited = visited_tiles(grid, culling, ellipse);
        EXPECT_EQ(std::count(visited.begin(), visited.end(), true), 0) << far;
      }
    }
  }
}

TEST(Tiling, SplatThatCoversTheImageVisitsEveryTile) {
  const TileGrid grid = make_tile_grid(75, 59, {16, 8});
  for (double size : {1e3, 1e6, 1e9}) {
    const Ellipse ellipse{30, 30, size * size, 0.5 * size * size, size * size, 0.9};
    const std::vector<bool> visited = visited_tiles(grid, Culling::kEllipse, ellipse);
    EXPECT_EQ(std::count(visited.begin(), visited.end(), true), grid.n_tiles()) << size;
  }
}

}  // namespace
}  // namespace b3dgs
