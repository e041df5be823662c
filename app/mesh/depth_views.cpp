#include "app/mesh/depth_views.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <tuple>

#include "core/check.h"
#include "core/parallel.h"
#include "raster/math/lens.h"
#include "scene/cameras/camera_lens.h"

namespace b3dgs {
namespace {

constexpr std::size_t kNeighbors = 6;
constexpr double kAgreement = 0.01;             // of the depth
constexpr double kLeastAxisCosine = 0.3;        // views that look away from each other are neighbours last
constexpr std::int64_t kMostSamples = 1 << 20;  // of the median

/// Returns the nearest views, preferably those that look the same way.
std::vector<const DepthView*> neighbors_of(std::size_t view, const std::vector<DepthView>& views) {
  const auto axis = [](const Camera& camera) {
    const std::array<double, 9>& r = camera.cam_from_world.rotation;
    return Vec3<double>{r[6], r[7], r[8]};
  };
  const Camera& from = views[view].camera;
  std::vector<std::tuple<bool, double, std::size_t>> order;  // looks away, distance, view
  for (std::size_t i = 0; i < views.size(); ++i) {
    if (i == view) continue;
    const Camera& to = views[i].camera;
    order.emplace_back(dot(axis(from), axis(to)) < kLeastAxisCosine, distance(from.center(), to.center()), i);
  }
  const std::size_t n = std::min(kNeighbors, order.size());
  std::partial_sort(order.begin(), order.begin() + static_cast<std::ptrdiff_t>(n), order.end());
  std::vector<const DepthView*> neighbors;
  for (std::size_t i = 0; i < n; ++i) neighbors.push_back(&views[std::get<2>(order[i])]);
  return neighbors;
}

bool agrees(const DepthView& view, const Vec3<double>& world) {
  const auto seen = view.camera.project(&world.x);
  if (!seen) return false;
  const double depth = view.depth[view.index(static_cast<int>(seen->x), static_cast<int>(seen->y))];
  return depth > 0 && std::abs(depth - seen->depth) <= kAgreement * seen->depth;
}

}  // namespace

std::vector<Vec3f> pixel_rays(const Camera& camera) {
  const LensRays lens(camera);
  std::vector<Vec3f> rays(static_cast<std::size_t>(camera.width) * camera.height);
  parallel_pool(camera.height, [&](std::int64_t row, int) {
    for (int x = 0; x < camera.width; ++x) {
      const auto at = lens.at(x + 0.5, static_cast<double>(row) + 0.5);
      if (!at) continue;
      const Vec3<double> ray{(*at)[0], (*at)[1], (*at)[2]};
      const double depth = lens_depth(camera.lens, ray);
      if (!(depth > 0)) continue;
      rays[static_cast<std::size_t>(row) * camera.width + x] = {
          static_cast<float>(ray.x / depth), static_cast<float>(ray.y / depth), static_cast<float>(ray.z / depth)};
    }
  });
  return rays;
}

DepthView make_depth_view(const Camera& camera, std::vector<float> depth, const float* normals, double far) {
  const std::vector<Vec3f> rays = pixel_rays(camera);
  B3DGS_CHECK(depth.size() == rays.size(), depth.size(), " depths of ", rays.size(), " pixels");
  DepthView view{camera, std::move(depth), std::vector<std::uint8_t>(rays.size())};
  parallel_each(static_cast<std::int64_t>(rays.size()), 4096, [&](std::int64_t i) {
    const Vec3f ray = rays[static_cast<std::size_t>(i)], normal{normals[3 * i], normals[3 * i + 1], normals[3 * i + 2]};
    const float cosine = -dot(normal, ray) / std::sqrt(dot(ray, ray));
    const float level = kCosineLevels * std::clamp(cosine, 0.0f, 1.0f);  // not a number if there is no ray
    float& at = view.depth[static_cast<std::size_t>(i)];
    const bool is_used = at > 0 && at <= far && level >= kLeastCosine;
    if (!is_used) at = 0;
    view.cosine[static_cast<std::size_t>(i)] = is_used ? static_cast<std::uint8_t>(std::lround(level)) : 0;
  });
  return view;
}

double keep_consistent(std::vector<DepthView>& views, int n_agree) {
  if (n_agree == 0) return 1;
  // Depths are cleared at the end, because the other views are compared with them.
  std::atomic<std::int64_t> n_all{0}, n_kept{0};
  parallel_pool(static_cast<std::int64_t>(views.size()), [&](std::int64_t v, int) {
    DepthView& view = views[static_cast<std::size_t>(v)];
    const std::vector<const DepthView*> neighbors = neighbors_of(static_cast<std::size_t>(v), views);
    const std::vector<Vec3f> rays = pixel_rays(view.camera);
    const std::array<double, 3> center = view.camera.center();
    for (std::size_t i = 0; i < rays.size(); ++i) {
      if (view.depth[i] == 0) continue;
      const double depth = view.depth[i];
      const std::array<double, 3> offset =
          rotated_back(view.camera.cam_from_world.rotation, {depth * rays[i].x, depth * rays[i].y, depth * rays[i].z});
      const Vec3<double> world{center[0] + offset[0], center[1] + offset[1], center[2] + offset[2]};
      int agree = 0;
      for (const DepthView* neighbor : neighbors) agree += agrees(*neighbor, world) ? 1 : 0;
      if (agree < n_agree) view.cosine[i] = 0;
      ++n_all;
      if (agree >= n_agree) ++n_kept;
    }
  });
  for (DepthView& view : views) {
    for (std::size_t i = 0; i < view.depth.size(); ++i) {
      if (view.cosine[i] == 0) view.depth[i] = 0;
    }
  }
  return n_all == 0 ? 0 : static_cast<double>(n_kept) / static_cast<double>(n_all);
}

double median_pixel_size(const std::vector<DepthView>& views) {
  std::int64_t n_pixels = 0;
  for (const DepthView& view : views) n_pixels += static_cast<std::int64_t>(view.depth.size());
  const std::size_t step = static_cast<std::size_t>(n_pixels / kMostSamples) + 1;
  std::vector<double> sizes;
  for (const DepthView& view : views) {
    for (std::size_t i = 0; i < view.depth.size(); i += step) {
      if (view.depth[i] > 0) sizes.push_back(view.depth[i] / view.camera.fx);
    }
  }
  if (sizes.empty()) return 0;
  const auto middle = sizes.begin() + static_cast<std::ptrdiff_t>(sizes.size() / 2);
  std::nth_element(sizes.begin(), middle, sizes.end());
  return *middle;
}

}  // namespace b3dgs
