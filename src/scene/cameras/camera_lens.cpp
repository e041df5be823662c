#include "scene/cameras/camera_lens.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <iterator>

#include "core/check.h"
#include "core/parallel.h"
#include "core/vec.h"
#include "raster/math/lens.h"

namespace b3dgs {
namespace {

// Perspective lenses do not reach 90 degrees, and nothing is known about fisheyes this far back.
constexpr double kMaxPerspectiveAngle = 85 * kPi / 180, kMaxFisheyeAngle = 175 * kPi / 180;
// Gaussians are linearised up to this multiple of the angle of the image's corners.
constexpr double kCornerMargin = 1.15;
// If the image of a solid angle has less area than this, relative to that on the axis, the formula counts as folded
// over.
constexpr double kLeastMagnification = 0.1;

LensPoint<double> seen_at(const Camera& camera, const Vec3<double>& point) {
  return lens_point(camera.lens, {camera.fx, camera.fy, camera.cx, camera.cy}, point);
}

Vec3<double> direction_at(double angle, double azimuth) {
  return {std::sin(angle) * std::cos(azimuth), std::sin(angle) * std::sin(azimuth), std::cos(angle)};
}

bool is_inside(const Camera& camera, const Vec2<double>& pixel) {
  return pixel.x >= 0 && pixel.x <= camera.width && pixel.y >= 0 && pixel.y <= camera.height;
}

}  // namespace

std::array<double, 2> distort(const LensParams<double>& lens, double x, double y) {
  const Vec2<double> place = lens_point(lens, {1, 1, 0, 0}, {x, y, 1}).pixel;
  return {place.x, place.y};
}

double monotonic_radius(LensParams<double> lens, double limit) {
  // Steps are far smaller than a pixel of an image whose corner is at `limit`. A turning point between two steps
  // changes the result by less than one step.
  constexpr int kSteps = 1 << 15;
  std::fill(lens.k + 7, std::end(lens.k), 0.0);  // only radial distortion counts
  double before = 0;
  for (int i = 1; i <= kSteps; ++i) {
    const double distorted = distort(lens, limit * i / kSteps, 0)[0];
    if (!(distorted > before)) return limit * (i - 1) / kSteps;
    before = distorted;
  }
  return limit;
}

Camera panorama_camera(ImageSize size) {
  Camera camera{size.width, size.height, size.width / (2 * kPi), size.height / kPi, 0.5 * size.width, 0.5 * size.height,
                {},         {}};
  camera.lens.kind = LensKind::kEquirectangular;
  return camera;
}

Camera native_camera(Camera camera, const std::string& place) {
  if (camera.is_pinhole() || camera.lens.kind == LensKind::kEquirectangular) return camera;
  constexpr int kAzimuths = 64, kAngles = 2000;
  const double limit = camera.lens.kind == LensKind::kFisheye ? kMaxFisheyeAngle : kMaxPerspectiveAngle;
  double fold = limit, corner = 0;
  std::vector<double> azimuths;
  azimuths.reserve(kAzimuths);
  for (int i = 0; i < kAzimuths; ++i) azimuths.push_back(2 * kPi * i / kAzimuths);
  for (const double x : {-camera.cx, camera.width - camera.cx}) {  // also the angles of the corners
    for (const double y : {-camera.cy, camera.height - camera.cy}) {
      azimuths.push_back(std::atan2(y / camera.fy, x / camera.fx));
    }
  }
  for (const double azimuth : azimuths) {
    for (int j = 1; j <= kAngles && limit * j / kAngles <= fold; ++j) {
      const double angle = limit * j / kAngles;
      const Vec3<double> at = direction_at(angle, azimuth);
      const LensPoint<double> seen = seen_at(camera, at);
      const double magnification = dot(cross(seen.row_x, seen.row_y), at) / (camera.fx * camera.fy);
      if (!(magnification > kLeastMagnification)) {
        fold = limit * (j - 1) / kAngles;
      } else if (is_inside(camera, seen.pixel)) {
        corner = std::max(corner, angle);
      }
    }
  }
  if (fold <= 0 || corner <= 0) {
    input_error(place, ": no pixel of ", camera.width, " x ", camera.height,
                " px shows a direction, so its parameters describe no lens; reconstruct the scene again");
  }
  camera.lens.max_angle = std::min(fold, kCornerMargin * corner);
  return camera;
}

LensRays::LensRays(const Camera& camera) : camera_(camera) {
  camera_.fx = camera_.fy = 1;
  camera_.cx = camera_.cy = 0;
  for (int i = 0; i <= kSteps; ++i) {
    const Vec2<double> place = seen_at(camera_, direction_at(camera.lens.max_angle * i / kSteps, 0)).pixel;
    radii_[i] = std::hypot(place.x, place.y);
  }
  camera_ = camera;
}

std::optional<std::array<double, 3>> LensRays::at(double x, double y) const {
  const double u = (x - camera_.cx) / camera_.fx, v = (y - camera_.cy) / camera_.fy;
  if (camera_.lens.kind == LensKind::kPinhole) {
    const double length = std::sqrt(u * u + v * v + 1);
    return std::array<double, 3>{u / length, v / length, 1 / length};
  }
  if (camera_.lens.kind == LensKind::kEquirectangular) {
    if (std::abs(v) > kPi / 2) return std::nullopt;
    return std::array<double, 3>{std::cos(v) * std::sin(u), std::sin(v), std::cos(v) * std::cos(u)};
  }
  // Newton's method on the sphere, starting at the angle that radial distortion alone would give.
  const double radius = std::hypot(u, v);
  const auto next = std::upper_bound(radii_.begin() + 1, radii_.end() - 1, radius);
  const double before = *(next - 1), step = *next > before ? std::min((radius - before) / (*next - before), 1.0) : 1.0;
  const double angle = camera_.lens.max_angle * (static_cast<double>(next - 1 - radii_.begin()) + step) / kSteps;
  Vec3<double> at = direction_at(angle, std::atan2(v, u));
  constexpr int kMaxSteps = 20;
  for (int i = 0; i < kMaxSteps; ++i) {
    const LensPoint<double> seen = seen_at(camera_, at);
    const double miss_x = x - seen.pixel.x, miss_y = y - seen.pixel.y;
    if (!(std::hypot(miss_x, miss_y) < 1e6 * (camera_.fx + camera_.fy))) return std::nullopt;
    if (std::hypot(miss_x, miss_y) < 1e-9 * (camera_.fx + camera_.fy)) {
      if (std::atan2(std::hypot(at.x, at.y), at.z) > camera_.lens.max_angle + 1e-9) return std::nullopt;
      return std::array<double, 3>{at.x, at.y, at.z};
    }
    // The shortest step that the Jacobian maps to the remaining error.
    const double xx = dot(seen.row_x, seen.row_x), xy = dot(seen.row_x, seen.row_y), yy = dot(seen.row_y, seen.row_y);
    const double det = xx * yy - xy * xy;
    at = at + ((yy * miss_x - xy * miss_y) / det) * seen.row_x + ((xx * miss_y - xy * miss_x) / det) * seen.row_y;
    at = (1 / std::sqrt(dot(at, at))) * at;
  }
  return std::nullopt;
}

std::shared_ptr<const Image8> lens_mask(const Camera& camera) {
  const LensRays rays(camera);
  const bool is_panorama = camera.lens.kind == LensKind::kEquirectangular;
  const double lowest = std::sin(kMaxLatitude * kPi / 180);
  auto mask = std::make_shared<Image8>(camera.width, camera.height, 1);
  std::atomic<bool> is_whole{true};
  parallel_pool(camera.height, [&](std::int64_t row, int) {
    for (int column = 0; column < camera.width; ++column) {
      const auto ray = rays.at(column + 0.5, static_cast<double>(row) + 0.5);
      const bool shows = ray && !(is_panorama && std::abs((*ray)[1]) > lowest);
      *mask->at(column, static_cast<int>(row)) = shows ? 255 : 0;
      if (!shows) is_whole = false;
    }
  });
  if (is_whole) return nullptr;
  return mask;
}

std::vector<Camera> pinhole_faces(const Camera& camera) {
  if (camera.is_pinhole()) return {camera};
  constexpr double kOneFace = 60 * kPi / 180, kHalfFace = 47 * kPi / 180;
  const bool is_panorama = camera.lens.kind == LensKind::kEquirectangular;
  const double angle = is_panorama ? kPi : camera.lens.max_angle;
  Camera face = camera.without_lens();
  if (angle <= kOneFace) return {face};
  // The face has as many pixels per angle as the photograph.
  face.width = face.height = std::max(1, static_cast<int>(std::lround(2 * camera.fx * std::tan(kHalfFace))));
  face.fx = face.fy = 0.5 * face.width / std::tan(kHalfFace);
  face.cx = face.cy = 0.5 * face.width;
  // Rows are the axes x, y, z of each face in the camera's frame.
  constexpr std::array<std::array<double, 9>, 6> kTurns{{{1, 0, 0, 0, 1, 0, 0, 0, 1},
                                                         {0, 0, -1, 0, 1, 0, 1, 0, 0},
                                                         {0, 0, 1, 0, 1, 0, -1, 0, 0},
                                                         {1, 0, 0, 0, 0, -1, 0, 1, 0},
                                                         {1, 0, 0, 0, 0, 1, 0, -1, 0},
                                                         {-1, 0, 0, 0, 1, 0, 0, 0, -1}}};
  std::vector<Camera> faces;
  for (const std::array<double, 9>& turn : kTurns) {
    if (turn[8] < 0 && angle < kPi - std::atan(std::sqrt(2.0))) break;  // the corners of the face behind
    Camera turned = face;
    const Pose& pose = camera.cam_from_world;
    turned.cam_from_world.translation = rotated(turn, pose.translation);
    for (std::size_t i = 0; i < 9; i += 3) {
      const std::array<double, 3> row = rotated_back(pose.rotation, {turn[i], turn[i + 1], turn[i + 2]});
      std::copy(row.begin(), row.end(), turned.cam_from_world.rotation.begin() + static_cast<std::ptrdiff_t>(i));
    }
    faces.push_back(turned);
  }
  return faces;
}

Warped warp_image(const Image8& image, const Camera& from, const Camera& to) {
  Warped warped{Image8(to.width, to.height, image.channels), Image8(to.width, to.height, 1)};
  const LensRays rays(to);
  const bool wraps = from.lens.kind == LensKind::kEquirectangular;
  parallel_pool(to.height, [&](std::int64_t row, int) {
    for (int column = 0; column < to.width; ++column) {
      const auto ray = rays.at(column + 0.5, static_cast<double>(row) + 0.5);
      if (!ray) continue;
      const auto world = rotated_back(to.cam_from_world.rotation, *ray);
      const auto place = from.image_of(rotated(from.cam_from_world.rotation, world));
      if (!place) continue;
      *warped.valid.at(column, static_cast<int>(row)) = 255;
      const double x = place->x - 0.5, y = place->y - 0.5, left = std::floor(x), top = std::floor(y);
      const auto value = [&](int dx, int dy, int channel) -> double {
        int u = static_cast<int>(left) + dx;
        u = wraps ? (u + image.width) % image.width : std::clamp(u, 0, image.width - 1);
        return image.at(u, std::clamp(static_cast<int>(top) + dy, 0, image.height - 1))[channel];
      };
      for (int channel = 0; channel < image.channels; ++channel) {
        const double upper = value(0, 0, channel) + (x - left) * (value(1, 0, channel) - value(0, 0, channel));
        const double lower = value(0, 1, channel) + (x - left) * (value(1, 1, channel) - value(0, 1, channel));
        warped.image.at(column, static_cast<int>(row))[channel] =
            static_cast<std::uint8_t>(std::lround(upper + (y - top) * (lower - upper)));
      }
    }
  });
  return warped;
}

double undistorted_share(const Camera& camera) {
  constexpr int kSide = 64;
  const LensRays rays(camera);
  int n_shown = 0, n_undistorted = 0;
  for (int i = 0; i < kSide * kSide; ++i) {
    const int column = i % kSide, row = i / kSide;
    const auto ray = rays.at((column + 0.5) * camera.width / kSide, (row + 0.5) * camera.height / kSide);
    if (!ray) continue;
    const auto [x, y, z] = *ray;
    ++n_shown;
    n_undistorted += z > 0 && is_inside(camera, {camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy});
  }
  return n_shown > 0 ? static_cast<double>(n_undistorted) / n_shown : 1;
}

}  // namespace b3dgs
