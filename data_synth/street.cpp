// `street`: aggregated LiDAR seen by a driving camera. Depths are log-uniform, so the load of the first iteration piles
// up in the tiles at the horizon.
#include <algorithm>
#include <cmath>

#include "data_synth/random.h"
#include "data_synth/synth_scene.h"
#include "scene/neighbors.h"

namespace b3dgs {
namespace {

constexpr double kNearest = 3, kFarthest = 400;  // m, along the road
constexpr double kRoadHalfWidth = 8;             // m
constexpr double kCameraHeight = 1.6;            // m above the road; +y is down
constexpr double kRoadRoughness = 0.02;          // m
constexpr double kFacadeSetback = 1.5;           // m, mean distance of facades from the road's edge
constexpr double kFacadeHeight = 9;              // m
constexpr double kFocal = 800;                   // px at a width of 960
constexpr double kViewSpacing = 1;               // m
// The images show the Gaussians that training starts from, but solid: at the initial 0.1 they would be a haze, and
// there would be nothing to learn.
constexpr double kOpacity = 0.8;

}  // namespace

SynthScene make_street(const SynthConfig& config) {
  Random random(config.seed);
  SynthScene scene;
  for (int i = 0; i < config.points; ++i) {
    const double z = kNearest * std::pow(kFarthest / kNearest, std::pow(random.uniform(), 1 / config.skew));
    double x = 0, y = 0;
    if (i % 3 == 0) {
      x = random.uniform(-kRoadHalfWidth, kRoadHalfWidth);
      y = kCameraHeight + kRoadRoughness * random.normal();
    } else {
      const double side = random.uniform() < 0.5 ? -1 : 1;
      x = side * (kRoadHalfWidth + random.exponential(kFacadeSetback));
      y = kCameraHeight - random.uniform(0, kFacadeHeight);
    }
    for (const double coordinate : {x, y, z}) scene.points.positions.push_back(static_cast<float>(coordinate));
    for (int c = 0; c < 3; ++c) scene.points.colors.push_back(static_cast<std::uint8_t>(random.uniform(0, 256)));
  }

  SplatCloud& truth = scene.truth;
  truth.means = scene.points.positions;
  for (const float squared : mean_squared_neighbor_distances(truth.means)) {
    truth.log_scales.insert(truth.log_scales.end(), 3, 0.5f * std::log(squared));
    truth.quats.insert(truth.quats.end(), {1, 0, 0, 0});
    truth.logit_opacities.push_back(logit(kOpacity));
  }
  for (const std::uint8_t color : scene.points.colors) truth.sh0.push_back(sh0_from_color(color / 255.0));

  for (int i = 0; i < config.views; ++i) {
    Camera camera;
    camera.width = config.width;
    camera.height = config.height;
    camera.fx = camera.fy = kFocal * config.width / 960;
    camera.cx = 0.5 * config.width;
    camera.cy = 0.5 * config.height;
    camera.cam_from_world.translation = {0, 0, -kViewSpacing * i};
    scene.cameras.push_back(camera);
  }
  return scene;
}

}  // namespace b3dgs
