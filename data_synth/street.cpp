// `street`: aggregated LiDAR points seen by a driving camera. Depths are log-uniform, so in the first iteration most of
// the load is in the tiles at the horizon.
#include <algorithm>
#include <cmath>

#include "core/vec.h"
#include "data_synth/random.h"
#include "data_synth/synth_scene.h"
#include "model/neighbors.h"

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
constexpr double kPointColorNoise = 0.1;         // maximum colour error of a point
constexpr double kShadeNoise = 0.05;             // standard deviation of the colour of a Gaussian
constexpr double kTruthShare = 0.5;              // true Gaussians per point
// For --truth points. At the initial opacity of 0.1, the images would be hazy, with nothing to learn.
constexpr double kOpacityOfPoints = 0.8;

using Vec = Vec3<double>;

struct Place {
  Vec position;
  bool is_road = false;
};

/// Every third point is on the road. Published benchmarks depend on the order of the random numbers: do not change it.
Place draw_place(int index, double skew, Random& random) {
  Place place;
  place.is_road = index % 3 == 0;
  Vec& at = place.position;
  at.z = kNearest * std::pow(kFarthest / kNearest, std::pow(random.uniform(), 1 / skew));
  if (place.is_road) {
    at.x = random.uniform(-kRoadHalfWidth, kRoadHalfWidth);
    at.y = kCameraHeight + kRoadRoughness * random.normal();
  } else {
    const double side = random.uniform() < 0.5 ? -1 : 1;
    at.x = side * (kRoadHalfWidth + random.exponential(kFacadeSetback));
    at.y = kCameraHeight - random.uniform(0, kFacadeHeight);
  }
  return place;
}

double fraction(double value) {
  return value - std::floor(value);
}

/// Returns asphalt with a dashed centre line and edge lines, or facades of 12 m, each in another colour, with windows.
Vec texture(const Place& place) {
  const Vec& at = place.position;
  if (place.is_road) {
    const bool is_dash = std::abs(at.x) < 0.2 && fraction(at.z / 6) < 0.5;
    const bool is_edge = std::abs(std::abs(at.x) - 7.2) < 0.2;
    const double grey = is_dash || is_edge ? 0.85 : 0.3 + 0.05 * std::sin(at.x) * std::sin(0.7 * at.z);
    return {grey, grey, grey};
  }
  if (fraction(at.z / 2.4) < 0.45 && fraction((kCameraHeight - at.y) / 3) > 0.4) return {0.12, 0.15, 0.2};
  const double house = std::floor(at.z / 12) + (at.x < 0 ? 0.5 : 0);
  return {0.35 + 0.5 * fraction(0.618 * house), 0.35 + 0.5 * fraction(0.414 * house),
          0.35 + 0.5 * fraction(0.732 * house)};
}

void append(const Vec& position, std::vector<float>& positions) {
  for (const double value : {position.x, position.y, position.z}) positions.push_back(static_cast<float>(value));
}

/// Adds scales and rotation of a flat Gaussian on its surface, with a random orientation in the plane.
void append_shape(bool is_road, double size, Random& random, SplatCloud& cloud) {
  const double stretch = random.uniform(1, 2), wide = size * random.uniform(0.6, 1.2), thin = 0.2 * size;
  const double half_turn = random.uniform(0, kPi);
  const auto turned = static_cast<float>(std::cos(half_turn)), axis = static_cast<float>(std::sin(half_turn));
  if (is_road) {
    for (const double scale : {wide * stretch, thin, wide / stretch}) {
      cloud.log_scales.push_back(static_cast<float>(std::log(scale)));
    }
    cloud.quats.insert(cloud.quats.end(), {turned, 0, axis, 0});
  } else {
    for (const double scale : {thin, wide * stretch, wide / stretch}) {
      cloud.log_scales.push_back(static_cast<float>(std::log(scale)));
    }
    cloud.quats.insert(cloud.quats.end(), {turned, axis, 0, 0});
  }
}

/// Makes Gaussians on the same surfaces, but not at the points, so that training must recover positions, sizes, shapes,
/// opacities and noise-free colours.
SplatCloud make_surfaces(const SynthConfig& config) {
  Random random(config.seed + (std::int64_t{1} << 40));  // independent of the random numbers of the points
  SplatCloud truth;
  std::vector<Place> places;
  const int n = std::max(1, static_cast<int>(kTruthShare * config.points));
  for (int i = 0; i < n; ++i) {
    places.push_back(draw_place(i, config.skew, random));
    append(places.back().position, truth.means);
  }
  const std::vector<float> squared_spacings = mean_squared_neighbor_distances(truth.means);
  for (std::size_t i = 0; i < places.size(); ++i) {
    append_shape(places[i].is_road, std::sqrt(squared_spacings[i]), random, truth);
    truth.logit_opacities.push_back(logit(random.uniform(0.3, 0.99)));
    const double shade = kShadeNoise * random.normal();
    const Vec color = texture(places[i]);
    for (const double value : {color.x, color.y, color.z}) {
      truth.sh0.push_back(sh0_from_color(std::clamp(value + shade, 0.02, 0.98)));
    }
  }
  return truth;
}

/// Makes the Gaussians that training starts from, but nearly opaque.
SplatCloud make_from_points(const PointCloud& points) {
  SplatCloud truth;
  truth.means = points.positions;
  for (const float squared : mean_squared_neighbor_distances(truth.means)) {
    truth.log_scales.insert(truth.log_scales.end(), 3, 0.5f * std::log(squared));
    truth.quats.insert(truth.quats.end(), {1, 0, 0, 0});
    truth.logit_opacities.push_back(logit(kOpacityOfPoints));
  }
  for (const std::uint8_t color : points.colors) truth.sh0.push_back(sh0_from_color(color / 255.0));
  return truth;
}

}  // namespace

SynthScene make_street(const SynthConfig& config) {
  const bool shows_points = config.truth == "points";
  Random random(config.seed);
  SynthScene scene;
  for (int i = 0; i < config.points; ++i) {
    const Place place = draw_place(i, config.skew, random);
    append(place.position, scene.points.positions);
    const Vec color = texture(place);
    for (const double value : {color.x, color.y, color.z}) {
      const double draw = random.uniform();
      const double found = shows_points ? 256 * draw : 255 * (value + kPointColorNoise * (2 * draw - 1));
      scene.points.colors.push_back(static_cast<std::uint8_t>(std::clamp(found, 0.0, 255.0)));
    }
  }
  scene.truth = shows_points ? make_from_points(scene.points) : make_surfaces(config);

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
