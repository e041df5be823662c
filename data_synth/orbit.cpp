// `orbit`: coloured solids on a chequered ground, made of flat Gaussians on the surfaces, and cameras on a ring of
// varying height around them. In the world frame, +z is up and the ground is at z = 0.
#include <algorithm>
#include <cmath>

#include "core/vec.h"
#include "data_synth/random.h"
#include "data_synth/synth_scene.h"
#include "data_synth/truth_mesh.h"
#include "raster/math/sh.h"

namespace b3dgs {
namespace {

constexpr double kOrbitRadius = 4.4;
constexpr double kFieldOfView = 50 * kPi / 180;    // horizontal
constexpr Vec3<double> kTarget{0, 0, 0.35};        // the cameras look here
constexpr Vec3<double> kLight{0.48, -0.36, 0.80};  // unit vector towards the light, for highlights
constexpr double kPointShare = 0.5;                // probability that a Gaussian also becomes a point of the scene
constexpr double kPointNoise = 0.01;               // standard deviation of the points' positions, world units
constexpr double kColorNoise = 8;                  // standard deviation of the points' colours, in 8-bit levels

using Vec = Vec3<double>;

Vec normalized(Vec a) {
  return (1 / std::sqrt(dot(a, a))) * a;
}
Vec mix(Vec a, Vec b, double share) {
  return (1 - share) * a + share * b;
}

/// A point on a surface, from which a Gaussian is made.
struct SurfacePoint {
  Vec position, normal, color;
  double gloss = 0;  // strength of the highlight
};

bool is_odd_check(double u, double v) {
  return (static_cast<int>(std::floor(u) + std::floor(v)) & 1) != 0;
}

SurfacePoint ground(Random& random) {
  const double radius = kGroundRadius * std::sqrt(random.uniform()), angle = random.uniform(0, 2 * kPi);
  const Vec at{radius * std::cos(angle), radius * std::sin(angle), 0};
  const Vec color = is_odd_check(at.x / 0.5, at.y / 0.5) ? Vec{0.75, 0.72, 0.65} : Vec{0.30, 0.38, 0.33};
  return {at, {0, 0, 1}, color};
}

/// Returns a point on a banded, glossy ball.
SurfacePoint ball(Random& random) {
  const double height = random.uniform(-1, 1), angle = random.uniform(0, 2 * kPi);
  const double ring = std::sqrt(1 - height * height);
  const Vec normal{ring * std::cos(angle), ring * std::sin(angle), height};
  const Vec color = mix({0.85, 0.25, 0.15}, {0.95, 0.80, 0.35}, 0.5 + 0.5 * std::sin(9 * height));
  return {kBallCenter + kBallRadius * normal, normal, color, 0.25};
}

/// Returns a point on a box. Each face has two shades of one colour. No bottom face: the box stands on the ground.
SurfacePoint box(Random& random) {
  static constexpr Vec kFaceColors[5] = {
      {0.2, 0.4, 0.8}, {0.8, 0.3, 0.6}, {0.3, 0.7, 0.4}, {0.9, 0.6, 0.2}, {0.6, 0.6, 0.9}};
  const int face = std::min(4, static_cast<int>(random.uniform(0, 5)));
  const double u = random.uniform(-1, 1), v = random.uniform(-1, 1);
  Vec local{}, normal{};
  if (face == 4) {
    local = {u, v, 1};
    normal = {0, 0, 1};
  } else {
    const double side = face % 2 == 0 ? 1 : -1;
    local = face < 2 ? Vec{side, u, v} : Vec{u, side, v};
    normal = face < 2 ? Vec{side, 0, 0} : Vec{0, side, 0};
  }
  const Vec color = (is_odd_check(3 * u, 3 * v) ? 1.0 : 0.55) * kFaceColors[face];
  return {kBoxCenter + kBoxHalf * local, normal, color};
}

/// Returns a point on a torus that lies on the ground, striped and glossy.
SurfacePoint ring(Random& random) {
  const double along = random.uniform(0, 2 * kPi);
  double around = 0;  // the outer side has more area than the inner one
  do {
    around = random.uniform(0, 2 * kPi);
  } while (random.uniform(0, kRingMajor + kRingMinor) > kRingMajor + kRingMinor * std::cos(around));
  const Vec outward{std::cos(along), std::sin(along), 0};
  const Vec normal = std::cos(around) * outward + Vec{0, 0, std::sin(around)};
  const Vec color = is_odd_check(12 * along / (2 * kPi), 0) ? Vec{0.1, 0.55, 0.6} : Vec{0.9, 0.9, 0.85};
  return {kRingCenter + kRingMajor * outward + kRingMinor * normal, normal, color, 0.2};
}

struct Solid {
  double area;
  SurfacePoint (*sample)(Random&);
};

constexpr Solid kSolids[] = {
    {kPi * kGroundRadius * kGroundRadius, ground},
    {4 * kPi * kBallRadius * kBallRadius, ball},
    {5 * (2 * kBoxHalf) * (2 * kBoxHalf), box},
    {4 * kPi * kPi * kRingMajor * kRingMinor, ring},
};

/// Solids get twice as many Gaussians per area as the ground, because the cameras look at them.
double weighted_area(const Solid& solid) {
  return solid.sample == ground ? solid.area : 2 * solid.area;
}

/// Appends a flat Gaussian on the surface, rotated randomly about the normal.
void append_gaussian(const SurfacePoint& at, double spacing, Random& random, SplatCloud& cloud) {
  const Vec helper = std::abs(at.normal.z) < 0.9 ? Vec{0, 0, 1} : Vec{1, 0, 0};
  const Vec u = normalized(cross(helper, at.normal)), v = cross(at.normal, u);
  const double turn = random.uniform(0, 2 * kPi);
  const Vec long_axis = std::cos(turn) * u + std::sin(turn) * v, short_axis = cross(at.normal, long_axis);
  const std::array<double, 4> quat =
      quaternion_from_rotation({long_axis.x, short_axis.x, at.normal.x, long_axis.y, short_axis.y, at.normal.y,
                                long_axis.z, short_axis.z, at.normal.z});
  const double size = spacing * random.uniform(0.55, 0.9), stretch = random.uniform(1, 1.8);

  for (const double value : {at.position.x, at.position.y, at.position.z}) {
    cloud.means.push_back(static_cast<float>(value));
  }
  for (const double scale : {size * stretch, size / stretch, 0.1 * spacing}) {
    cloud.log_scales.push_back(static_cast<float>(std::log(scale)));
  }
  for (const double value : quat) cloud.quats.push_back(static_cast<float>(value));
  cloud.logit_opacities.push_back(logit(random.uniform(0.7, 0.98)));
  const double shade = 0.05 * random.normal();
  for (const double value : {at.color.x, at.color.y, at.color.z}) {
    cloud.sh0.push_back(sh0_from_color(std::clamp(value + shade, 0.02, 0.98)));
  }

  // A highlight, brightest for view directions along the reflected light. The coefficients of a lobe are the SH basis
  // evaluated at its axis. White light adds the same value to each channel.
  static constexpr double kDegreeWeights[4] = {0, 1, 0.6, 0.3};
  const Vec axis = kLight - 2 * dot(at.normal, kLight) * at.normal;
  double basis[16];
  sh_basis(cloud.sh_degree, axis, basis);
  for (int degree = 1, k = 1; degree <= cloud.sh_degree; ++degree) {
    for (; k < sh_coefficient_count(degree); ++k) {
      cloud.shN.insert(cloud.shN.end(), 3, static_cast<float>(at.gloss * kDegreeWeights[degree] * basis[k]));
    }
  }
}

Camera look_at(Vec eye, Vec target, int width, int height) {
  const Vec forward = normalized(target - eye);
  const Vec right = normalized(cross(forward, {0, 0, 1}));
  const Vec down = cross(forward, right);
  Camera camera;
  camera.width = width;
  camera.height = height;
  camera.fx = camera.fy = 0.5 * width / std::tan(0.5 * kFieldOfView);
  camera.cx = 0.5 * width;
  camera.cy = 0.5 * height;
  camera.cam_from_world.rotation = {right.x, right.y, right.z, down.x, down.y, down.z, forward.x, forward.y, forward.z};
  camera.cam_from_world.translation = {-dot(right, eye), -dot(down, eye), -dot(forward, eye)};
  return camera;
}

}  // namespace

SynthScene make_orbit(const SynthConfig& config) {
  Random random(config.seed);
  SynthScene scene;
  scene.truth.sh_degree = config.sh_degree;
  double total_area = 0;
  for (const Solid& solid : kSolids) total_area += weighted_area(solid);

  for (int i = 0; i < config.points; ++i) {
    double place = random.uniform(0, total_area);
    const Solid* solid = kSolids;
    while (solid != std::end(kSolids) - 1 && place >= weighted_area(*solid)) place -= weighted_area(*solid++);
    const double density = config.points / total_area * weighted_area(*solid) / solid->area;
    const SurfacePoint at = solid->sample(random);
    append_gaussian(at, 1 / std::sqrt(density), random, scene.truth);

    if (random.uniform() >= kPointShare) continue;
    for (const double value : {at.position.x, at.position.y, at.position.z}) {
      scene.points.positions.push_back(static_cast<float>(value + kPointNoise * random.normal()));
    }
    for (int c = 0; c < 3; ++c) {
      const double color = 255 * color_from_sh0(scene.truth.sh0[3 * static_cast<std::size_t>(i) + c]);
      scene.points.colors.push_back(
          static_cast<std::uint8_t>(std::clamp(color + kColorNoise * random.normal(), 0.0, 255.0)));
    }
  }

  for (int i = 0; i < config.views; ++i) {
    const double azimuth = 2 * kPi * i / config.views;
    const double elevation = (35 + 15 * std::sin(3 * azimuth)) * kPi / 180;
    const double radius = kOrbitRadius * random.uniform(0.9, 1.1);
    const Vec offset{radius * std::cos(elevation) * std::cos(azimuth), radius * std::cos(elevation) * std::sin(azimuth),
                     radius * std::sin(elevation)};
    scene.cameras.push_back(look_at(kTarget + offset, kTarget, config.width, config.height));
  }
  return scene;
}

}  // namespace b3dgs
