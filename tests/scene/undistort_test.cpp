#include "scene/cameras/undistort.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>

#include "core/check.h"
#include "scene/colmap/colmap.h"
#include "scene/images/image.h"
#include "support/expect_error.h"

namespace b3dgs {
namespace {

using test::fails_with;

Camera camera(CameraModel model, std::vector<double> params, std::uint64_t width = 100, std::uint64_t height = 100) {
  return camera_of({1, model, width, height, std::move(params)}, "camera 1");
}

struct Point2 {
  double x, y;
};

// Reference implementations of the models' formulas, as functions of the ray.
Point2 opencv_pixel(double x, double y) {
  const double r2 = x * x + y * y, radial = 1 - 0.12 * r2 + 0.03 * r2 * r2;
  return {150 * (x * radial + 2 * 0.004 * x * y - 0.003 * (r2 + 2 * x * x)) + 104.5,
          140 * (y * radial + 0.004 * (r2 + 2 * y * y) - 2 * 0.003 * x * y) + 78};
}
Point2 fisheye_pixel(double x, double y) {
  const double r = std::hypot(x, y), theta = std::atan2(r, 1.0), t2 = theta * theta;
  const double scale = theta * (1 + 0.02 * t2 - 0.01 * t2 * t2) / r;
  return {100 * scale * x + 96.25, 110 * scale * y + 83};
}

// Paints a soft dot whose centre of mass is (x, y), in coordinates where the upper left pixel centre is (0.5, 0.5).
void paint_dot(Image8& image, Point2 center) {
  for (int row = 0; row < image.height; ++row) {
    for (int column = 0; column < image.width; ++column) {
      const double d2 = std::pow(column + 0.5 - center.x, 2) + std::pow(row + 0.5 - center.y, 2);
      const int value = static_cast<int>(std::lround(250 * std::exp(-d2 / 2)));
      for (int c = 0; c < 3; ++c) {
        std::uint8_t& pixel = image.pixels[(static_cast<std::size_t>(row) * image.width + column) * 3 + c];
        pixel = static_cast<std::uint8_t>(std::max<int>(pixel, value));
      }
    }
  }
}

Point2 find_dot(const Image8& image, Point2 near) {
  double sum = 0, x = 0, y = 0;
  for (int row = std::max(0, int(near.y) - 8); row < std::min(image.height, int(near.y) + 9); ++row) {
    for (int column = std::max(0, int(near.x) - 8); column < std::min(image.width, int(near.x) + 9); ++column) {
      const double value = image.pixels[(static_cast<std::size_t>(row) * image.width + column) * 3];
      sum += value;
      x += value * (column + 0.5);
      y += value * (row + 0.5);
    }
  }
  return {x / sum, y / sum};
}

template <class Project>
void expect_dots_where_the_pinhole_sees_them(CameraModel model, std::vector<double> params, Project&& project) {
  constexpr int kWidth = 200, kHeight = 160;
  const Camera lens = camera(model, std::move(params), kWidth, kHeight);
  const Undistorter undistorter(lens, "camera 1");
  int n_dots = 0;
  for (double x = -0.5; x <= 0.5; x += 0.125) {
    for (double y = -0.4; y <= 0.4; y += 0.1) {
      const Point2 pinhole{lens.fx * x + lens.cx, lens.fy * y + lens.cy};
      const bool has_room = pinhole.x > 12 && pinhole.x < kWidth - 12 && pinhole.y > 12 && pinhole.y < kHeight - 12;
      if (!has_room || std::hypot(x, y) < 1e-9) continue;
      Image8 distorted(kWidth, kHeight, 3);
      paint_dot(distorted, project(x, y));
      const Point2 found = find_dot(undistorter.apply(distorted), pinhole);
      // The map stretches one side of the dot more than the other, which moves its centre of mass by about 0.01 px.
      EXPECT_NEAR(found.x, pinhole.x, 0.06) << x << ", " << y;
      EXPECT_NEAR(found.y, pinhole.y, 0.06) << x << ", " << y;
      ++n_dots;
    }
  }
  EXPECT_GT(n_dots, 30);
}

TEST(Undistorter, PutsOpenCvDotsWhereThePinholeSeesThem) {
  expect_dots_where_the_pinhole_sees_them(CameraModel::kOpenCv, {150, 140, 104.5, 78, -0.12, 0.03, 0.004, -0.003},
                                          opencv_pixel);
}

TEST(Undistorter, PutsFisheyeDotsWhereThePinholeSeesThem) {
  expect_dots_where_the_pinhole_sees_them(CameraModel::kOpenCvFisheye, {100, 110, 96.25, 83, 0.02, -0.01, 0, 0},
                                          fisheye_pixel);
}

TEST(Undistorter, WithoutNoticeableDistortionChangesNoPixel) {
  Image8 image(31, 17, 3);
  std::mt19937 random(1);
  for (std::uint8_t& value : image.pixels) value = static_cast<std::uint8_t>(random() % 256);
  const Undistorter undistorter(camera(CameraModel::kSimpleRadial, {20, 15.3, 8.1, -1e-9}, 31, 17), "camera 1");
  EXPECT_EQ(undistorter.apply(image).pixels, image.pixels);
  EXPECT_EQ(undistorter.valid(), nullptr);
}

TEST(Undistorter, MasksPixelsOutsideThePhotograph) {
  // Pincushion: the corner of the output would come from outside, the middle from inside.
  const Undistorter undistorter(camera(CameraModel::kSimpleRadial, {100, 50, 50, 0.3}), "camera 1");
  ASSERT_NE(undistorter.valid(), nullptr);
  const Image8& valid = *undistorter.valid();
  const auto at = [&](int x, int y) { return int{valid.pixels[static_cast<std::size_t>(y) * 100 + x]}; };
  EXPECT_EQ(at(0, 0), 0);
  EXPECT_EQ(at(99, 99), 0);
  EXPECT_EQ(at(50, 50), 255);
  // On the axis through the centre: r (1 + 0.3 r^2) = 0.5 at r = 0.4681, which is pixel 96.81.
  EXPECT_EQ(at(96, 50), 255);
  EXPECT_EQ(at(97, 50), 0);
  Image8 white(100, 100, 3);
  std::fill(white.pixels.begin(), white.pixels.end(), std::uint8_t{255});
  const Image8 undistorted = undistorter.apply(white);
  for (std::size_t i = 0; i < valid.pixels.size(); ++i) ASSERT_EQ(undistorted.pixels[3 * i], valid.pixels[i]);
}

TEST(Undistorter, MasksPixelsBeyondTheMonotonicRadius) {
  // r - r^3 / 2 turns back at r = 0.816: the output at r = 1.2 would come from r = 0.336, which is inside.
  const Undistorter undistorter(camera(CameraModel::kSimpleRadial, {40, 50, 50, -0.5}), "camera 1");
  ASSERT_NE(undistorter.valid(), nullptr);
  EXPECT_EQ(undistorter.valid()->pixels[50 * 100 + 50 + 48], 0);    // r = 1.21
  EXPECT_EQ(undistorter.valid()->pixels[50 * 100 + 50 + 31], 255);  // r = 0.79
}

TEST(Undistorter, RejectsALensThatLeavesNoValidPixel) {
  Camera lost = camera(CameraModel::kSimpleRadial, {100, 50, 50, 0.1});
  lost.cx = -100000;
  EXPECT_TRUE(fails_with<InputError>({"camera 1", "no valid pixel"}, [&] { Undistorter(lost, "camera 1"); }));
}

TEST(ShrinkMask, KeepsOnlyPixelsThatAreEntirelyValid) {
  Image8 mask(5, 2, 1);
  mask.pixels = {255, 255, 255, 255, 255,  //
                 255, 255, 255, 255, 0};
  EXPECT_EQ(shrink_mask(mask, 5, 1).pixels, (std::vector<std::uint8_t>{255, 255, 255, 255, 0}));
  EXPECT_EQ(shrink_mask(mask, 2, 1).pixels, (std::vector<std::uint8_t>{255, 0}));
  mask.pixels = {255, 255, 0, 255, 255, 255, 255, 255, 255, 255};
  // Both halves of 2.5 pixels touch the middle one.
  EXPECT_EQ(shrink_mask(mask, 2, 1).pixels, (std::vector<std::uint8_t>{0, 0}));
}

}  // namespace
}  // namespace b3dgs
