#include "app/view/viewed_scene.h"

#include <algorithm>
#include <cmath>

#include "scene/images/image.h"
#include "scene/view_image.h"

namespace b3dgs {
namespace {

constexpr std::size_t kSamples = 100000;  // points that are examined

/// Half of the values lie within `spread` of `middle`.
struct Middle {
  double middle = 0, spread = 0;
};

Middle middle_of(std::vector<double> values) {
  if (values.empty()) return {};
  const auto median = [](std::vector<double>& v) {
    const auto at = v.begin() + static_cast<std::ptrdiff_t>(v.size() / 2);
    std::nth_element(v.begin(), at, v.end());
    return *at;
  };
  Middle result;
  result.middle = median(values);
  for (double& value : values) value = std::abs(value - result.middle);
  result.spread = median(values);
  return result;
}

}  // namespace

ViewedScene viewed_scene(const Scene& scene, const std::vector<float>& points, const std::string& title) {
  ViewedScene viewed;
  viewed.title = title;
  viewed.frame = scene.frame;
  for (const auto* views : {&scene.train, &scene.test}) {
    for (const View& view : *views) {
      viewed.views.push_back({view.name, view.camera, views == &scene.test, view.image != nullptr});
    }
  }
  const std::size_t n = points.size() / 3, stride = std::max<std::size_t>(1, n / kSamples);
  double squares = 0;
  for (std::size_t axis = 0; axis < 3; ++axis) {
    std::vector<double> values;
    for (std::size_t i = 0; i < n; i += stride) {
      if (std::isfinite(points[3 * i + axis])) values.push_back(points[3 * i + axis]);
    }
    const Middle middle = middle_of(std::move(values));
    viewed.center[axis] = middle.middle;
    squares += middle.spread * middle.spread;
  }
  viewed.radius = squares > 0 ? std::sqrt(squares) : 1;
  return viewed;
}

const View& view_at(const Scene& scene, int index) {
  const auto i = static_cast<std::size_t>(index);
  return i < scene.train.size() ? scene.train[i] : scene.test.at(i - scene.train.size());
}

Image8 WatchedScene::photograph(int view, ImageSize size) const {
  const std::shared_ptr<const Image8> image = view_at(source_, view).image->read();
  if (image->width == size.width && image->height == size.height) return *image;
  return resize_image(*image, size.width, size.height);
}

}  // namespace b3dgs
