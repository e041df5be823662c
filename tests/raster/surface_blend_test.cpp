// Tests what splats add to the surface of a pixel.
#include "raster/math/surface_blend.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

namespace b3dgs {
namespace {

/// A splat at a pixel.
struct Entry {
  float alpha, depth;
  float variance = 0;
  Vec3f normal{0, 0, -1};
  float slope_x = 0;  // of inverse depth
  float dx = 0;       // px
};

struct Surface {
  float depth = NAN, confidence = NAN;
  Vec3f normal{NAN, NAN, NAN};
};

Surface blend(DepthKind kind, const std::vector<Entry>& entries) {
  SurfacePixel<float> pixel{1, 0, 0, 0, 0, 0, 0, 0, 0};
  for (const Entry& e : entries) {
    const float value = kind == DepthKind::kMean ? e.depth : 1 / e.depth;
    blend_surface(pixel, kind, {value, e.slope_x, 0, e.variance, e.normal, 0}, e.alpha >= kAlphaMin, e.alpha, e.dx,
                  0.0f);
  }
  Surface out;
  GeometryArgs args;
  args.kind = kind;
  args.grid.image_width = args.grid.image_height = 1;
  args.out = {&out.depth, &out.normal.x, &out.confidence};
  store_surface(args, 0, 0,
                {std::abs(pixel.transmittance), pixel.first, pixel.share, pixel.offset, pixel.square, pixel.variance,
                 Vec3f{pixel.normal_x, pixel.normal_y, pixel.normal_z}});
  return out;
}

constexpr DepthKind kKinds[] = {DepthKind::kSurface, DepthKind::kMedian, DepthKind::kMean};

TEST(SurfaceBlend, OneOpaqueSplatIsTheSurface) {
  for (const DepthKind kind : kKinds) {
    const Surface found = blend(kind, {{0.99f, 2, 0, {0.6f, 0, -0.8f}}, {0.9f, 7}});
    EXPECT_NEAR(found.depth, kind == DepthKind::kMean ? (0.99 * 2 + 0.009 * 7) / 0.999 : 2, 1e-5);
    EXPECT_NEAR(found.normal.x, 0.6, 0.01);
    EXPECT_EQ(found.confidence == 1, kind != DepthKind::kMean);
  }
}

TEST(SurfaceBlend, OnlySplatsInTheBandCount) {
  // Transmittances 1, 0.7, 0.49, 0.098. The band is shared by 0.11 of the second and 0.09 of the third.
  const std::vector<Entry> entries{{0.3f, 1}, {0.3f, 2}, {0.8f, 4}, {0.5f, 9}};
  EXPECT_NEAR(blend(DepthKind::kSurface, entries).depth, 0.2 / (0.11 / 2 + 0.09 / 4), 1e-5);
  EXPECT_NEAR(blend(DepthKind::kMedian, entries).depth, 2, 1e-5);
  EXPECT_NEAR(blend(DepthKind::kMean, entries).depth,
              (0.3 * 1 + 0.21 * 2 + 0.392 * 4 + 0.049 * 9) / (0.3 + 0.21 + 0.392 + 0.049), 1e-5);
}

TEST(SurfaceBlend, ATransparentPixelHasNone) {
  for (const DepthKind kind : kKinds) {
    for (const std::vector<Entry>& entries :
         {std::vector<Entry>{}, {{0.5f, 2}}, {{0.2f, 2}, {0.3f, 3}}, {{1e-3f, 2}}}) {
      const Surface found = blend(kind, entries);
      EXPECT_EQ(found.depth, 0);
      EXPECT_EQ(found.confidence, 0);
      EXPECT_EQ(found.normal.x, 0);
      EXPECT_EQ(found.normal.z, 0);
    }
    EXPECT_GT(blend(kind, {{0.51f, 2}}).depth, 1);
  }
}

TEST(SurfaceBlend, ThePlaneDeterminesTheDepthNearTheCentre) {
  // Inverse depth 0.5 at the centre, 0.02 more per px.
  const auto depth_at = [](DepthKind kind, float dx) {
    return blend(kind, {{0.9f, 2, 0, {0, 0, -1}, 0.02f, dx}}).depth;
  };
  EXPECT_NEAR(depth_at(DepthKind::kSurface, 2), 1 / 0.54, 1e-5);
  EXPECT_NEAR(depth_at(DepthKind::kSurface, -4), 1 / 0.42, 1e-5);
  EXPECT_EQ(depth_at(DepthKind::kMedian, 7), 2) << "1 / 0.64 differs by more than a fifth";
  EXPECT_EQ(depth_at(DepthKind::kSurface, -5), 2) << "and so does 1 / 0.4";
  EXPECT_EQ(depth_at(DepthKind::kSurface, 1e30f), 2);
  EXPECT_EQ(depth_at(DepthKind::kSurface, INFINITY), 2);
}

TEST(SurfaceBlend, ConfidenceFallsWithTheSpreadOfDepth) {
  const auto confidence = [](const std::vector<Entry>& entries) {
    return blend(DepthKind::kSurface, entries).confidence;
  };
  EXPECT_NEAR(confidence({{0.9f, 2, 1e-4f}}), 0.5, 1e-5) << "thickness of 1 %";
  EXPECT_NEAR(confidence({{0.9f, 2, 1}}), 1e-4, 1e-6);
  // Half of the band each, and inverse depths 1 % above and below their mean.
  EXPECT_NEAR(confidence({{0.5f, 1 / 0.505f}, {0.9f, 1 / 0.495f}}), 0.5, 1e-4);
  EXPECT_LT(confidence({{0.5f, 1}, {0.9f, 2}}), 0.002) << "an edge";
  EXPECT_GT(confidence({{0.3f, 1}, {0.95f, 2}}), 0.999) << "behind a thin veil, the depth is clear";
}

TEST(SurfaceBlend, NormalsAreWeightedLikeColours) {
  const Surface found = blend(DepthKind::kSurface, {{0.6f, 2, 0, {1, 0, 0}}, {0.75f, 2, 0, {0, 1, 0}}});
  EXPECT_NEAR(found.normal.x, 0.6 / std::hypot(0.6, 0.3), 1e-6);
  EXPECT_NEAR(found.normal.y, 0.3 / std::hypot(0.6, 0.3), 1e-6);
}

TEST(SurfaceBlend, EndsWhereTheBlendEnds) {
  // The third splat would leave 1e-5, so it is not blended.
  const Surface found = blend(DepthKind::kMean, {{0.99f, 2}, {0.9f, 3}, {0.99f, 1e6f}, {0.1f, 1e6f}});
  EXPECT_NEAR(found.depth, (0.99 * 2 + 0.009 * 3) / 0.999, 1e-4);
}

}  // namespace
}  // namespace b3dgs
