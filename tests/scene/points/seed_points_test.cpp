// Points found in photographs of a wall with a picture on it, and of an object in front of an empty background.
#include "scene/points/point_cloud.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <utility>
#include <vector>

#include "core/random.h"
#include "scene/cameras/coordinate_frame.h"
#include "scene/scene_model.h"
#include "scene/view_image.h"

namespace b3dgs {
namespace {

constexpr double kWall = kTypicalDepth;  // z of the wall; cameras are near z = 0 and look along z

/// A smooth random pattern on the wall, 0 to 255, different for each colour.
double brightness(double x, double y, std::uint32_t color) {
  const auto value = [&](int column, int row) {
    const auto key = static_cast<std::uint64_t>((column + 1000) * 4096 + row + 1000);
    return random_uniform({7, RandomStream::kScenePoints, color}, key)[0];
  };
  const double u = 4 * x, v = 4 * y;
  const int column = static_cast<int>(std::floor(u)), row = static_cast<int>(std::floor(v));
  const double fu = u - column, fv = v - row;
  return 255 * ((1 - fv) * ((1 - fu) * value(column, row) + fu * value(column + 1, row)) +
                fv * ((1 - fu) * value(column, row + 1) + fu * value(column + 1, row + 1)));
}

Camera camera_at(double x, double y) {
  Camera camera;
  camera.width = 120;
  camera.height = 90;
  camera.fx = camera.fy = 100;
  camera.cx = 60;
  camera.cy = 45;
  camera.cam_from_world.translation = {-x, -y, 0};
  return camera;
}

/// Returns views of a wall. `is_plain`: without the picture. `object`: half the side of a square around the middle,
/// outside of which the scene is empty; 0: an infinite wall.
std::vector<SeedView> views_of_wall(bool is_plain = false, double object = 0) {
  std::vector<SeedView> views;
  for (int i = 0; i < 12; ++i) {
    SeedView view;
    view.camera = camera_at(0.4 * (i % 4) - 0.6, 0.4 * (i / 4) - 0.4);
    view.image = Image8(view.camera.width, view.camera.height, 3);
    if (object > 0) view.content = Image8(view.camera.width, view.camera.height, 1);
    const std::array<double, 3> center = view.camera.center();
    for (int row = 0; row < view.camera.height; ++row) {
      for (int column = 0; column < view.camera.width; ++column) {
        const double x = center[0] + kWall * (column + 0.5 - view.camera.cx) / view.camera.fx;
        const double y = center[1] + kWall * (row + 0.5 - view.camera.cy) / view.camera.fy;
        const auto at = static_cast<std::size_t>(row * view.camera.width + column);
        const bool is_there = object == 0 || (std::abs(x) < object && std::abs(y) < object);
        if (object > 0) view.content.pixels[at] = is_there ? 255 : 0;
        for (std::uint32_t c = 0; c < 3; ++c) {
          const double value = is_plain ? 90 : brightness(x, y, c);
          view.image.pixels[3 * at + c] = static_cast<std::uint8_t>(is_there ? value : 0);
        }
      }
    }
    views.push_back(std::move(view));
  }
  return views;
}

double share_near_wall(const PointCloud& points, double tolerance) {
  double n = 0;
  for (std::size_t i = 2; i < points.positions.size(); i += 3) {
    n += std::abs(points.positions[i] - kWall) < tolerance * kWall ? 1 : 0;
  }
  return n / static_cast<double>(points.size());
}

/// Returns a scene with a point every 0.1 on the wall where x < `end`.
Scene scene_of_wall(float end) {
  Scene scene;
  for (SeedView& seed : views_of_wall()) {
    View view;
    view.camera = seed.camera;
    view.image = std::make_shared<ViewImage>(std::move(seed.image));
    scene.train.push_back(std::move(view));
  }
  for (float x = -6; x < end; x += 0.1f) {
    for (float y = -6; y < 6; y += 0.1f) scene.points.positions.insert(scene.points.positions.end(), {x, y, kWall});
  }
  scene.points.colors.resize(scene.points.positions.size());
  return scene;
}

TEST(PointsOfPhotographs, AreAddedInPartsWithoutPoints) {
  Scene scene = scene_of_wall(0);
  const std::int64_t n_own = scene.points.size(), n_added = add_points_of_photographs(scene, {});
  EXPECT_GT(n_added, 5000);
  ASSERT_EQ(scene.points.size(), n_own + n_added);
  ASSERT_EQ(scene.points.colors.size(), scene.points.positions.size());
  PointCloud added;
  added.positions.assign(scene.points.positions.begin() + 3 * n_own, scene.points.positions.end());
  EXPECT_GT(share_near_wall(added, 0.05), 0.9);
  for (std::size_t i = 0; i < added.positions.size(); i += 3) {
    if (std::abs(added.positions[i + 2] - kWall) > 0.05 * kWall) continue;
    EXPECT_GT(added.positions[i], -0.2);
  }
}

TEST(PointsOfPhotographs, AreNotNeededWhereTheScenesOwnAreEverywhere) {
  Scene scene = scene_of_wall(6);
  EXPECT_EQ(add_points_of_photographs(scene, {}), 0);
  Scene none;
  EXPECT_EQ(add_points_of_photographs(none, {}), 0) << "no views";
}

TEST(PointsOfPhotographs, AreNotLookedForWhereMasksLeaveEverythingOut) {
  for (const bool is_empty : {false, true}) {  // empty or masked pixels
    Scene scene = scene_of_wall(0);
    for (View& view : scene.train) {
      Image8 left(view.camera.width, view.camera.height, 1), right = left;  // halves of the wall's middle
      for (int row = 0; row < left.height; ++row) {
        for (int column = 0; column < left.width; ++column) {
          const double x = view.camera.center()[0] + kWall * (column + 0.5 - view.camera.cx) / view.camera.fx;
          (x < 0 ? left : right).pixels[static_cast<std::size_t>(row * left.width + column)] = 255;
        }
      }
      (is_empty ? view.empty : view.valid) = std::make_shared<const Image8>(is_empty ? right : left);
    }
    EXPECT_EQ(add_points_of_photographs(scene, {}), 0);
  }
}

TEST(SeedPoints, LieOnWhatThePhotographsShow) {
  const PointCloud points = seed_points(views_of_wall(), 600);
  EXPECT_NEAR(static_cast<double>(points.size()), 600, 12);
  EXPECT_GT(share_near_wall(points, 0.05), 0.9);
  for (std::size_t i = 0; i < points.positions.size(); i += 3) {
    if (std::abs(points.positions[i + 2] - kWall) > 0.02 * kWall) continue;
    for (std::uint32_t c = 0; c < 3; ++c) {
      EXPECT_NEAR(points.colors[i + c], brightness(points.positions[i], points.positions[i + 1], c), 40);
    }
  }
}

TEST(SeedPoints, TheSameViewsGiveTheSamePoints) {
  const std::vector<SeedView> views = views_of_wall();
  EXPECT_EQ(seed_points(views, 200).positions, seed_points(views, 200).positions);
}

TEST(SeedPoints, NoneIsWhereAViewShowsNothing) {
  for (const bool is_plain : {false, true}) {
    const std::vector<SeedView> views = views_of_wall(is_plain, 1);
    const PointCloud points = seed_points(views, 600);
    EXPECT_GT(points.size(), 300);
    for (std::size_t i = 0; i < points.positions.size(); i += 3) {
      for (const SeedView& view : views) {
        const auto place = view.camera.project(&points.positions[i]);
        if (!place) continue;
        const auto at = static_cast<std::size_t>(place->y) * 120 + static_cast<std::size_t>(place->x);
        EXPECT_GT(view.content.pixels[at], 0);
        EXPECT_GE(place->depth, 0.1 * kTypicalDepth);
      }
    }
  }
}

TEST(SeedPoints, PixelsThatDoNotCountGiveNone) {
  std::vector<SeedView> views = views_of_wall();
  for (SeedView& view : views) {
    view.valid = Image8(view.camera.width, view.camera.height, 1);
    std::fill(view.valid.pixels.begin(), view.valid.pixels.begin() + 120 * 45, 255);  // the upper half
  }
  const PointCloud points = seed_points(views, 600);
  EXPECT_GT(points.size(), 500);
  for (std::size_t i = 0; i < points.positions.size(); i += 3) {
    bool is_in_an_upper_half = false;
    for (const SeedView& view : views) {
      const auto place = view.camera.project(&points.positions[i]);
      is_in_an_upper_half = is_in_an_upper_half || (place && place->y < 45.001);
    }
    EXPECT_TRUE(is_in_an_upper_half);
  }
}

TEST(SeedPoints, WithoutAnythingToCompareTheyAreAboutAsFarAsTheScene) {
  for (const std::vector<SeedView>& views : {views_of_wall(/*is_plain=*/true), {views_of_wall()[0]}}) {
    const PointCloud points = seed_points(views, 240);
    EXPECT_GE(points.size(), 200);
    for (std::size_t i = 2; i < points.positions.size(); i += 3) {
      EXPECT_GE(points.positions[i], 0.5 * kTypicalDepth - 1e-5);
      EXPECT_LE(points.positions[i], 2 * kTypicalDepth + 1e-5);
    }
  }
}

}  // namespace
}  // namespace b3dgs
