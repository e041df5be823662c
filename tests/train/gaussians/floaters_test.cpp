#include "train/gaussians/gaussian_model.h"

#include <gtest/gtest.h>

#include <cmath>

namespace b3dgs {
namespace {

/// Returns a camera at (x, 0, 0) that looks along +z.
PinholeView camera_at(float x) {
  return {{1, 0, 0, 0, 1, 0, 0, 0, 1}, {-x, 0, 0}, {x, 0, 0}, 64, 64, 32, 24, 64, 48};
}

struct Ball {
  double x, y, z, scale, opacity;
};

GaussianTensors gaussians_of(const std::vector<Ball>& balls) {
  const auto n = static_cast<std::int64_t>(balls.size());
  GaussianTensors gaussians{torch::zeros({n, 3}), torch::zeros({n, 3}),    torch::zeros({n, 4}),
                            torch::zeros({n}),    torch::zeros({n, 1, 3}), torch::zeros({n, 0, 3})};
  gaussians.quats.select(1, 0).fill_(1);
  for (std::int64_t i = 0; i < n; ++i) {
    const Ball& ball = balls[static_cast<std::size_t>(i)];
    gaussians.means[i] = torch::tensor({ball.x, ball.y, ball.z});
    gaussians.log_scales[i].fill_(std::log(ball.scale));
    gaussians.logit_opacities[i] = std::log(ball.opacity / (1 - ball.opacity));
  }
  return gaussians;
}

// Two walls are opaque together. The other Gaussians are in front of them unless noted.
const Ball kWall{0, 0, 5, 6, 0.99}, kWallBehind{0, 0, 5.5, 6, 0.99};
const Ball kOfBoth{0.5, 0, 4, 0.1, 0.9};
const Ball kBehindTheCameras{0.5, 0, -2, 0.1, 0.9}, kBehindTheWalls{0.5, 0, 30, 0.1, 0.9};
const Ball kFaint{0.5, 0.5, 4, 0.1, 0.003};  // below 1/255
const Ball kOfOne{-1.5, 0, 3.5, 0.05, 0.9};  // at the edge of the first camera's image, outside that of the other
const Ball kCloseToOne{0, 0, 0.3, 0.005, 0.9};

class CountFloaters : public ::testing::Test {
 protected:
  static FloaterCount count(const std::vector<Ball>& balls, const std::vector<CameraView>& views) {
    Rasterizer rasterizer(torch::kCPU);
    return count_floaters(rasterizer, gaussians_of(balls), views, RenderSettings{});
  }
};

void expect_counts(const FloaterCount& found, const FloaterCount& expected) {
  EXPECT_EQ(found.unseen, expected.unseen);
  EXPECT_EQ(found.one_view, expected.one_view);
  EXPECT_EQ(found.close, expected.close);
  EXPECT_EQ(found.large, expected.large);
}

TEST_F(CountFloaters, TellsWhatViewsSee) {
  const std::vector<CameraView> views{camera_at(0), camera_at(1)};
  expect_counts(count({kWall, kWallBehind, kOfBoth}, views), {0, 0, 0, 2});
  expect_counts(count({kWall, kWallBehind, kOfBoth, kBehindTheCameras}, views), {1, 0, 0, 2});
  expect_counts(count({kWall, kWallBehind, kOfBoth, kBehindTheWalls}, views), {1, 0, 0, 2});
  expect_counts(count({kWall, kWallBehind, kOfBoth, kFaint}, views), {1, 0, 0, 2});
  expect_counts(count({kWall, kWallBehind, kOfBoth, kOfOne}, views), {0, 1, 0, 2});
  expect_counts(count({kWall, kWallBehind, kOfBoth, kCloseToOne}, views), {0, 1, 1, 2});
  expect_counts(count({kBehindTheCameras, kFaint, kOfBoth, kOfOne}, views), {2, 1, 0, 0});
}

TEST_F(CountFloaters, TakesAPanoramaForOneViewAlsoAtItsSeam) {
  CameraView panorama(PinholeView{{1, 0, 0, 0, 1, 0, 0, 0, 1}, {0, 0, 0}, {0, 0, 0}, 15.28f, 15.28f, 48, 24, 96, 48});
  panorama.lens.kind = LensKind::kEquirectangular;
  const Ball at_the_seam{0, 0, -4, 0.1, 0.9};
  expect_counts(count({at_the_seam}, {panorama}), {0, 1, 0, 0});
}

TEST_F(CountFloaters, TakesEachViewByItself) {
  const std::vector<Ball> balls{kOfBoth, kOfOne, kBehindTheCameras};
  expect_counts(count(balls, {camera_at(0)}), {1, 2, 0, 0});
  expect_counts(count(balls, {camera_at(1)}), {2, 1, 0, 0});
  expect_counts(count(balls, {}), {3, 0, 0, 0});
  expect_counts(count({}, {camera_at(0)}), {0, 0, 0, 0});
}

}  // namespace
}  // namespace b3dgs
