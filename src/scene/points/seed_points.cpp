#include "scene/points/point_cloud.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <optional>

#include "core/parallel.h"
#include "core/random.h"

namespace b3dgs {
namespace {

constexpr int kDepths = 128;                                                       // depths of the sweep
constexpr double kNearest = 0.25 * kTypicalDepth, kFarthest = 20 * kTypicalDepth;  // limits of the sweep
constexpr double kLeastDepth = 0.1 * kTypicalDepth;                                // limit for a point in any view
constexpr std::size_t kNeighbours = 6;
constexpr int kPatch = 3, kPatchStep = 2;  // px
constexpr std::size_t kPatchPixels = kPatch * kPatch;
constexpr float kClearCost = 12, kClearShare = 0.6f, kLeastContrast = 4;  // of 255
constexpr float kUnseen = std::numeric_limits<float>::max();

using Vec = std::array<double, 3>;

/// Returns the direction of a pixel in the camera's frame, with z = 1.
Vec direction(const Camera& camera, double x, double y) {
  return {(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, 1};
}

Vec point_at(const Camera& camera, double x, double y, double depth) {
  Vec point = direction(camera, x, y);
  for (std::size_t i = 0; i < 3; ++i) point[i] = depth * point[i] - camera.cam_from_world.translation[i];
  return rotated_back(camera.cam_from_world.rotation, point);
}

const std::uint8_t* pixel(const Image8& image, double x, double y) {
  return image.at(static_cast<int>(x), static_cast<int>(y));
}

/// Returns true everywhere for a mask without pixels.
bool is_set(const Image8& mask, double x, double y) {
  return mask.pixels.empty() || *pixel(mask, x, y) != 0;
}

/// Returns whether no view rules the point out, because it is empty there or too close to the camera.
bool may_be(const std::vector<SeedView>& views, const Vec& point) {
  return std::all_of(views.begin(), views.end(), [&](const SeedView& view) {
    const auto place = view.camera.project(point.data());
    return !place || (place->depth >= kLeastDepth && is_set(view.content, place->x, place->y));
  });
}

/// Returns the views that see most of the same from another place, which are those with the nearest centres. Leaves out
/// views at almost the same place, whose rays are too parallel to determine a depth, and those turned by more than 60
/// degrees.
std::vector<std::size_t> neighbours_of(const std::vector<SeedView>& views, std::size_t view) {
  constexpr double kLeastDistance = 0.03 * kTypicalDepth, kLeastCosine = 0.5;
  const Vec center = views[view].camera.center();
  const std::array<double, 9>& own = views[view].camera.cam_from_world.rotation;
  std::vector<std::pair<double, std::size_t>> others;
  for (std::size_t i = 0; i < views.size(); ++i) {
    const std::array<double, 9>& r = views[i].camera.cam_from_world.rotation;
    const double cosine = own[6] * r[6] + own[7] * r[7] + own[8] * r[8];
    const double apart = distance(views[i].camera.center(), center);
    if (i == view || apart < kLeastDistance || cosine < kLeastCosine) continue;
    others.emplace_back(apart, i);
  }
  std::sort(others.begin(), others.end());
  others.resize(std::min(kNeighbours, others.size()));
  std::vector<std::size_t> chosen;
  chosen.reserve(others.size());
  for (const auto& [apart, other] : others) chosen.push_back(other);
  return chosen;
}

/// The pixels around one, as another view sees them at some depth: depth * direction + offset, in pixels times depth.
struct Sight {
  const Image8* image = nullptr;
  std::array<Vec, kPatchPixels> directions{};
  Vec offset{};
};

Vec in_pixels(const Camera& camera, const Vec& v) {
  return {camera.fx * v[0] + camera.cx * v[2], camera.fy * v[1] + camera.cy * v[2], v[2]};
}

/// A pixel whose depth is searched for, and the result.
struct Seed {
  std::size_t view = 0;
  double x = 0, y = 0;
  std::optional<double> depth{};
};

using Patch = std::array<std::array<float, 3>, kPatchPixels>;

Sight sight(const SeedView& from, const SeedView& to, const Seed& at) {
  Sight result;
  result.image = &to.image;
  const Pose &own = from.camera.cam_from_world, &other = to.camera.cam_from_world;
  const auto turned = [&](const Vec& v) { return rotated(other.rotation, rotated_back(own.rotation, v)); };
  for (std::size_t i = 0; i < kPatchPixels; ++i) {
    const int column = static_cast<int>(i) % kPatch - kPatch / 2, row = static_cast<int>(i) / kPatch - kPatch / 2;
    const Vec ray = direction(from.camera, at.x + kPatchStep * column, at.y + kPatchStep * row);
    result.directions[i] = in_pixels(to.camera, turned(ray));
  }
  const Vec t = turned(own.translation), &to_other = other.translation;
  result.offset = in_pixels(to.camera, {to_other[0] - t[0], to_other[1] - t[1], to_other[2] - t[2]});
  return result;
}

/// Interpolates bilinearly between pixel centres at (i + 0.5, j + 0.5). Edges continue outwards.
std::array<float, 3> color_at(const Image8& image, float x, float y) {
  const float column = std::clamp(x - 0.5f, 0.0f, static_cast<float>(image.width - 1));
  const float row = std::clamp(y - 0.5f, 0.0f, static_cast<float>(image.height - 1));
  const int left = std::min(static_cast<int>(column), std::max(0, image.width - 2));
  const int above = std::min(static_cast<int>(row), std::max(0, image.height - 2));
  const float u = column - static_cast<float>(left), v = row - static_cast<float>(above);
  const std::uint8_t* const a = image.at(left, above);
  const int right = image.width > 1 ? 3 : 0, below = image.height > 1 ? 3 * image.width : 0;
  std::array<float, 3> color{};
  for (int c = 0; c < 3; ++c) {
    const float upper = (1 - u) * a[c] + u * a[right + c], lower = (1 - u) * a[below + c] + u * a[below + right + c];
    color[c] = (1 - v) * upper + v * lower;
  }
  return color;
}

/// Reads the patch at a depth in the other view. Fails if a part of it is outside.
bool look(const Sight& sight, double depth, Patch& patch) {
  for (std::size_t i = 0; i < kPatchPixels; ++i) {
    const Vec& d = sight.directions[i];
    const double z = depth * d[2] + sight.offset[2];
    if (!(z > kLeastDepth)) return false;
    const double x = (depth * d[0] + sight.offset[0]) / z, y = (depth * d[1] + sight.offset[1]) / z;
    if (!(x >= 0 && x < sight.image->width && y >= 0 && y < sight.image->height)) return false;
    patch[i] = color_at(*sight.image, static_cast<float>(x), static_cast<float>(y));
  }
  return true;
}

/// Returns the mean absolute difference of two patches, 0 to 255. The mean difference of each channel counts a third,
/// because exposures vary.
float difference(const Patch& a, const Patch& b) {
  float sum = 0;
  for (std::size_t c = 0; c < 3; ++c) {
    float mean = 0;
    for (std::size_t i = 0; i < kPatchPixels; ++i) mean += (b[i][c] - a[i][c]) / kPatchPixels;
    for (std::size_t i = 0; i < kPatchPixels; ++i) sum += std::abs(b[i][c] - a[i][c] - mean) / kPatchPixels;
    sum += std::abs(mean) / 3;
  }
  return sum / 3;
}

/// Returns the mean over the better half of the views, because the point may be hidden in the others.
float cost_at(const std::vector<Sight>& sights, const Patch& own, double depth) {
  std::array<float, kNeighbours> costs{};
  std::size_t n = 0;
  Patch seen;
  for (const Sight& sight : sights) {
    if (!look(sight, depth, seen)) continue;
    const float cost = difference(own, seen);
    std::size_t place = n++;
    for (; place > 0 && costs[place - 1] > cost; --place) costs[place] = costs[place - 1];
    costs[place] = cost;  // ascending
  }
  // Two views may look alike by chance.
  if (n < std::min<std::size_t>(3, sights.size()) || n < 2) return kUnseen;
  const std::size_t half = std::max<std::size_t>(2, (n + 1) / 2);
  float sum = 0;
  for (std::size_t i = 0; i < half; ++i) sum += costs[i];
  return sum / static_cast<float>(half);
}

double depth_of_step(double step) {
  const double share = step / (kDepths - 1);
  return 1 / ((1 - share) / kNearest + share / kFarthest);
}

/// Returns nothing if no depth is clearly better than others.
std::optional<double> sweep(const std::vector<SeedView>& views, const std::vector<std::size_t>& neighbours,
                            const Seed& at) {
  const SeedView& own = views[at.view];
  Patch patch;
  if (!look(sight(own, own, at), kTypicalDepth, patch)) return std::nullopt;
  std::vector<Sight> sights;
  sights.reserve(neighbours.size());
  for (const std::size_t other : neighbours) sights.push_back(sight(own, views[other], at));
  std::array<float, kDepths> costs{};
  std::size_t best = 0, n_seen = 0;
  for (std::size_t i = 0; i < kDepths; ++i) {
    costs[i] = cost_at(sights, patch, depth_of_step(static_cast<double>(i)));
    if (costs[i] < costs[best]) best = i;
    n_seen += costs[i] < kUnseen ? 1 : 0;
  }
  if (n_seen < 2 || costs[best] > kClearCost) return std::nullopt;
  std::array<float, kDepths> sorted = costs;
  std::nth_element(sorted.begin(), sorted.begin() + static_cast<std::ptrdiff_t>(n_seen / 2), sorted.end());
  const float usual = sorted[n_seen / 2];
  if (usual < kLeastContrast || costs[best] > kClearShare * usual) return std::nullopt;
  double finest = static_cast<double>(best);
  float least = costs[best];
  for (const double shift : {-0.75, -0.5, -0.25, 0.25, 0.5, 0.75}) {
    const double step = std::clamp(static_cast<double>(best) + shift, 0.0, kDepths - 1.0);
    const float cost = cost_at(sights, patch, depth_of_step(step));
    if (cost < least) {
      least = cost;
      finest = step;
    }
  }
  return depth_of_step(finest);
}

std::vector<Seed> seeds_of(const std::vector<SeedView>& views, std::size_t view, std::int64_t n) {
  const std::vector<std::size_t> neighbours = neighbours_of(views, view);
  const RandomKey key{0, RandomStream::kScenePoints, static_cast<std::uint32_t>(view)};
  const SeedView& own = views[view];
  std::vector<Seed> seeds;
  for (std::int64_t i = 0; i < 4 * n && static_cast<std::int64_t>(seeds.size()) < n; ++i) {
    const std::array<float, 4> random = random_uniform(key, static_cast<std::uint64_t>(i));
    Seed seed{view, double{random[0]} * own.camera.width, double{random[1]} * own.camera.height};
    if (!is_set(own.content, seed.x, seed.y) || !is_set(own.valid, seed.x, seed.y)) continue;
    seed.depth = sweep(views, neighbours, seed);
    if (seed.depth && !may_be(views, point_at(own.camera, seed.x, seed.y, *seed.depth))) seed.depth.reset();
    seeds.push_back(seed);
  }
  return seeds;
}

/// Gives the others the depth of the nearest pixel that has one or, if that is ruled out, a random one.
void fill(const std::vector<SeedView>& views, std::vector<Seed>& seeds) {
  std::vector<Seed> clear;
  std::copy_if(seeds.begin(), seeds.end(), std::back_inserter(clear), [](const Seed& seed) { return !!seed.depth; });
  for (std::size_t i = 0; i < seeds.size(); ++i) {
    Seed& seed = seeds[i];
    if (seed.depth) continue;
    const auto pixels_apart = [&](const Seed& other) { return std::hypot(other.x - seed.x, other.y - seed.y); };
    const auto nearest = std::min_element(
        clear.begin(), clear.end(), [&](const Seed& a, const Seed& b) { return pixels_apart(a) < pixels_apart(b); });
    const Camera& camera = views[seed.view].camera;
    const auto try_depth = [&](double depth) {
      if (may_be(views, point_at(camera, seed.x, seed.y, depth))) seed.depth = depth;
    };
    if (nearest != clear.end()) try_depth(*nearest->depth);
    constexpr std::uint64_t kTries = 16;
    const RandomKey key{1, RandomStream::kScenePoints, static_cast<std::uint32_t>(seed.view)};
    for (std::uint64_t attempt = 0; attempt < kTries && !seed.depth; ++attempt) {
      const double u = 2.0 * random_uniform(key, kTries * i + attempt)[0] - 1;
      try_depth(kTypicalDepth * std::exp2(u));  // half to twice
    }
  }
}

}  // namespace

PointCloud seed_points(const std::vector<SeedView>& views, std::int64_t n, SeedDepth depth) {
  std::vector<std::vector<Seed>> of_views(views.size());
  const auto n_views = static_cast<std::int64_t>(views.size());
  parallel_pool(n_views, [&](std::int64_t view, int) {
    std::vector<Seed>& seeds = of_views[view];
    seeds = seeds_of(views, view, (n + n_views - 1) / n_views);
    if (depth == SeedDepth::kAny) fill(views, seeds);
  });
  PointCloud points;
  for (const std::vector<Seed>& seeds : of_views) {
    for (const Seed& seed : seeds) {
      if (!seed.depth) continue;
      const SeedView& view = views[seed.view];
      for (const double value : point_at(view.camera, seed.x, seed.y, *seed.depth)) {
        points.positions.push_back(static_cast<float>(value));
      }
      const std::uint8_t* const color = pixel(view.image, seed.x, seed.y);
      points.colors.insert(points.colors.end(), color, color + 3);
    }
  }
  return points;
}

}  // namespace b3dgs
