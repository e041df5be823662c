#include "scene/scene_model.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <mutex>
#include <optional>
#include <utility>

#include "core/parallel.h"
#include "scene/cameras/camera_lens.h"
#include "scene/cameras/coordinate_frame.h"
#include "scene/images/image.h"
#include "scene/view_image.h"

namespace b3dgs {
namespace {

constexpr double kLargePart = 0.1;  // of the photographs

/// Returns the number of points for a scene without any: at most two for each pixel of a photograph of their mean size.
double count_for(const Scene& scene) {
  constexpr double kMost = 50000;
  double pixels = 0;
  for (const View& view : scene.train) pixels += static_cast<double>(view.camera.width) * view.camera.height;
  return std::min(kMost, 2 * pixels / static_cast<double>(scene.train.size()));
}

/// Returns the camera of an image of at most kSeedSide px a side.
Camera small_camera(const Camera& camera) {
  const double scale = std::min(1.0, static_cast<double>(kSeedSide) / std::max(camera.width, camera.height));
  const auto side = [&](int full) { return std::max(1, static_cast<int>(std::lround(scale * full))); };
  return camera.scaled_to(side(camera.width), side(camera.height));
}

/// Returns the pinholes that the search needs: the view itself, or the faces of one that keeps its lens.
std::vector<SeedView> faces_of(SeedView& view) {
  std::vector<SeedView> faces;
  if (view.camera.is_pinhole()) {
    faces.push_back(std::move(view));
    return faces;
  }
  if (view.valid.pixels.empty()) {
    view.valid = Image8(view.camera.width, view.camera.height);
    std::fill(view.valid.pixels.begin(), view.valid.pixels.end(), std::uint8_t{255});
  }
  for (const Camera& camera : pinhole_faces(view.camera)) {
    SeedView& face = faces.emplace_back();
    face.camera = camera;
    face.valid = warp_image(view.valid, view.camera, camera).image;
    for (std::uint8_t& pixel : face.valid.pixels) pixel = pixel == 255 ? 255 : 0;
    if (!view.image.pixels.empty()) face.image = warp_image(view.image, view.camera, camera).image;
    if (!view.content.pixels.empty()) face.content = warp_image(view.content, view.camera, camera).image;
  }
  return faces;
}

/// Returns small copies of at most 120 photographs, evenly spaced in the list, with cameras in `frame`. Without
/// `decodes` they have only masks, without colours and alpha.
std::vector<SeedView> seed_views(const Scene& scene, const CoordinateFrame& frame, bool decodes,
                                 const ProgressFn& progress) {
  constexpr std::size_t kMostViews = 120;
  const std::size_t n = std::min(kMostViews, scene.train.size());
  std::vector<std::vector<SeedView>> faces_of_views(n);
  std::mutex mutex;
  std::size_t n_done = 0;
  parallel_pool(static_cast<std::int64_t>(n), [&](std::int64_t i, int) {
    const View& view = scene.train[static_cast<std::size_t>(i) * scene.train.size() / n];
    SeedView seed;
    seed.camera = small_camera(change_frame(scene.frame, frame, view.camera));
    std::optional<Image8> content;
    if (decodes) {
      seed.image = resize_image(*view.image->read(), seed.camera.width, seed.camera.height);
      content = view.image->read_alpha();
    }
    if (view.empty) {
      if (!content)
        content.emplace(view.camera.width, view.camera.height, 1).pixels.assign(view.empty->pixels.size(), 255);
      for (std::size_t p = 0; p < content->pixels.size(); ++p) {
        if (view.empty->pixels[p] != 0) content->pixels[p] = 0;
      }
    }
    if (content) seed.content = resize_image(*content, seed.camera.width, seed.camera.height);
    if (view.valid) seed.valid = shrink_mask(*view.valid, seed.camera.width, seed.camera.height);
    faces_of_views[i] = faces_of(seed);
    const std::lock_guard<std::mutex> lock(mutex);
    if (progress) progress("looking for points in the photographs", ++n_done, n);
  });
  std::vector<SeedView> faces;
  for (std::vector<SeedView>& of_view : faces_of_views) {
    for (SeedView& face : of_view) faces.push_back(std::move(face));
  }
  return faces;
}

/// Returns blocks of `side` pixels that are 255 where the camera sees a point.
Image8 blocks_with_points(const Camera& camera, const PointCloud& points, int side) {
  constexpr std::int64_t kEnough = 200000;  // enough points for a few hundred blocks
  Image8 blocks((camera.width + side - 1) / side, (camera.height + side - 1) / side, 1);
  const std::int64_t step = std::max<std::int64_t>(1, points.size() / kEnough);
  for (std::int64_t i = 0; i < points.size(); i += step) {
    const auto place = camera.project(&points.positions[3 * i]);
    if (place) *blocks.at(static_cast<int>(place->x) / side, static_cast<int>(place->y) / side) = 255;
  }
  return blocks;
}

/// Returns the share of blocks without points among the pixels that are neither empty nor masked. Limits `valid` to
/// these.
double keep_parts_without_points(const PointCloud& points, std::vector<SeedView>& views) {
  std::vector<std::array<double, 2>> counts(views.size());  // without points, all
  parallel_pool(static_cast<std::int64_t>(views.size()), [&](std::int64_t i, int) {
    SeedView& view = views[i];
    auto& [n_without, n_all] = counts[i];
    const int side = std::max(1, std::max(view.camera.width, view.camera.height) / 10);
    const Image8 blocks = blocks_with_points(view.camera, points, side);
    Image8 without(view.camera.width, view.camera.height, 1);
    for (int row = 0; row < view.camera.height; ++row) {
      for (int column = 0; column < view.camera.width; ++column) {
        const auto is_set = [&](const Image8& mask) { return mask.pixels.empty() || *mask.at(column, row) != 0; };
        if (!is_set(view.valid) || !is_set(view.content)) continue;
        n_all += 1;
        if (*blocks.at(column / side, row / side) != 0) continue;
        n_without += 1;
        *without.at(column, row) = 255;
      }
    }
    view.valid = std::move(without);
  });
  double n_without = 0, n_all = 0;
  for (const auto& [own_without, own_all] : counts) n_without += own_without, n_all += own_all;
  return n_all > 0 ? n_without / n_all : 0;
}

}  // namespace

std::int64_t add_points_of_photographs(Scene& scene, const ProgressFn& progress) {
  if (scene.train.empty()) return 0;
  if (scene.points.size() == 0) {
    std::vector<Camera> cameras;
    for (const View& view : scene.train) cameras.push_back(change_frame(scene.frame, {}, view.camera));
    const CoordinateFrame own = choose_frame(cameras, {});  // also if a resumed training gave the scene's frame
    scene.points = in_frame(scene.frame, in_world(own, seed_points(seed_views(scene, own, /*decodes=*/true, progress),
                                                                   static_cast<std::int64_t>(count_for(scene)))));
    return scene.points.size();
  }
  std::vector<SeedView> views = seed_views(scene, scene.frame, /*decodes=*/false, {});
  if (keep_parts_without_points(scene.points, views) <= kLargePart) return 0;
  views = seed_views(scene, scene.frame, /*decodes=*/true, progress);
  const double share = keep_parts_without_points(scene.points, views);  // alpha also marks empty pixels
  if (share <= kLargePart) return 0;
  const PointCloud found = seed_points(views, std::llround(share * count_for(scene)), SeedDepth::kClear);
  PointCloud& points = scene.points;
  points.positions.insert(points.positions.end(), found.positions.begin(), found.positions.end());
  points.colors.insert(points.colors.end(), found.colors.begin(), found.colors.end());
  return found.size();
}

}  // namespace b3dgs
