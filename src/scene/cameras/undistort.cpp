#include "scene/cameras/undistort.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <limits>
#include <opencv2/imgproc.hpp>

#include "core/check.h"
#include "core/parallel.h"

namespace b3dgs {
namespace {

std::int64_t map_bytes(ImageSize size) {
  return std::int64_t{9} * size.width * size.height;  // two floats and the mask
}

}  // namespace

Undistorter::Undistorter(const Lens& lens, int width, int height, const std::string& place)
    : width_(width), height_(height), source_(std::size_t{2} * width * height) {
  constexpr int kMaxSide = std::numeric_limits<short>::max() - 1;  // cv::remap's coordinates are 16-bit
  if (width > kMaxSide || height > kMaxSide) {
    input_error(place, ": images of ", width, " x ", height, " px are too large to undistort (expected at most ",
                kMaxSide, " px per side); run \"colmap image_undistorter\" and train on its output");
  }
  const double far_x = std::max(lens.cx, width - lens.cx) / lens.fx,
               far_y = std::max(lens.cy, height - lens.cy) / lens.fy;
  const double max_radius = monotonic_radius(lens, std::hypot(far_x, far_y));
  auto valid = std::make_shared<Image8>(width, height, 1);
  std::atomic<std::int64_t> n_valid{0};
  parallel_pool(height, [&](std::int64_t row, int) {
    std::int64_t n_valid_here = 0;
    for (int column = 0; column < width; ++column) {
      const double x = (column + 0.5 - lens.cx) / lens.fx, y = (static_cast<double>(row) + 0.5 - lens.cy) / lens.fy;
      const auto [xd, yd] = distort(lens, x, y);
      const double u = lens.fx * xd + lens.cx, v = lens.fy * yd + lens.cy;  // centres at + 0.5, as in COLMAP
      const bool is_inside = u >= 0 && u <= width && v >= 0 && v <= height && std::hypot(x, y) <= max_radius;
      const std::size_t pixel = static_cast<std::size_t>(row) * width + column;
      source_[2 * pixel] = is_inside ? static_cast<float>(u - 0.5) : 0.0f;
      source_[2 * pixel + 1] = is_inside ? static_cast<float>(v - 0.5) : 0.0f;
      valid->pixels[pixel] = is_inside ? 255 : 0;
      n_valid_here += is_inside;
    }
    n_valid += n_valid_here;
  });
  if (n_valid == 0) {
    input_error(place,
                ": undistortion leaves no valid pixel, so its parameters describe no lens; reconstruct the scene ",
                "again");
  }
  if (n_valid < std::int64_t{width} * height) valid_ = std::move(valid);
}

Image8 Undistorter::apply(const Image8& image) const {
  Image8 result(width_, height_, 3);
  apply_into(image, result.pixels.data());
  return result;
}

void Undistorter::apply_into(const Image8& image, std::uint8_t* rgb) const {
  remap({image.width, image.height}, image.channels, CV_8UC3, image.pixels.data(), rgb);
  for (std::size_t i = 0; valid_ && i < valid_->pixels.size(); ++i) {
    if (valid_->pixels[i] == 0) std::fill_n(rgb + 3 * i, 3, std::uint8_t{0});
  }
}

Depth16 Undistorter::apply(const Depth16& map) const {
  Depth16 result(width_, height_);
  remap({map.width, map.height}, 1, CV_16UC1, map.values.data(), result.values.data());
  return result;
}

Image8 Undistorter::apply_to_mask(const Image8& mask) const {
  Image8 result(width_, height_, 1);
  remap({mask.width, mask.height}, mask.channels, CV_8UC1, mask.pixels.data(), result.pixels.data());
  for (std::size_t i = 0; valid_ && i < result.pixels.size(); ++i) {
    if (valid_->pixels[i] == 0) result.pixels[i] = 0;
  }
  return result;
}

void Undistorter::remap(ImageSize size, int channels, int type, const void* from, void* to) const {
  B3DGS_CHECK(size.width == width_ && size.height == height_ && channels == CV_MAT_CN(type), "an image of ", size.width,
              " x ", size.height, " x ", channels, " for a map of ", width_, " x ", height_);
  // OpenCV only reads these two; its Mat has no const form.
  const cv::Mat image(height_, width_, type, const_cast<void*>(from));
  const cv::Mat map(height_, width_, CV_32FC2, const_cast<float*>(source_.data()));
  cv::Mat result(height_, width_, type, to);
  // Border pixels are replicated because a source within half a pixel of the edge is still inside the photograph.
  cv::remap(image, result, map, cv::noArray(), cv::INTER_LINEAR, cv::BORDER_REPLICATE);
}

int UndistorterCache::add_group(const Lens& lens, ImageSize size, const std::string& place) {
  groups_.push_back(std::make_unique<Group>());
  groups_.back()->lens = lens;
  groups_.back()->size = size;
  groups_.back()->place = place;
  return static_cast<int>(groups_.size()) - 1;
}

std::int64_t UndistorterCache::most_kept_bytes() const {
  std::int64_t bytes = 0;
  for (const auto& group : groups_) bytes += map_bytes(group->size);
  return std::min(bytes, max_bytes_);
}

std::shared_ptr<const Undistorter> UndistorterCache::get(int group_number) {
  Group& group = *groups_.at(static_cast<std::size_t>(group_number));
  const std::lock_guard<std::mutex> building(group.build_mutex);
  std::unique_lock<std::mutex> lock(mutex_);
  group.last_use = ++n_uses_;
  if (group.map) return group.map;
  lock.unlock();
  auto map = std::make_shared<const Undistorter>(group.lens, group.size.width, group.size.height, group.place);
  const std::int64_t bytes = map_bytes(group.size);
  if (bytes > max_bytes_) return map;
  lock.lock();
  while (kept_bytes_ + bytes > max_bytes_) {
    Group* oldest = nullptr;
    for (const auto& other : groups_) {
      if (other->map && (oldest == nullptr || other->last_use < oldest->last_use)) oldest = other.get();
    }
    oldest->map.reset();
    kept_bytes_ -= map_bytes(oldest->size);
  }
  group.map = map;
  kept_bytes_ += bytes;
  return map;
}

Image8 shrink_mask(const Image8& mask, int width, int height) {
  B3DGS_CHECK(mask.channels == 1 && width <= mask.width && height <= mask.height && width > 0 && height > 0,
              "a mask of ", mask.width, " x ", mask.height, " x ", mask.channels, " for ", width, " x ", height);
  // Target pixel i covers the source pixels that [i * from / to, (i + 1) * from / to) touches.
  const auto first = [](std::int64_t i, int from, int to) { return static_cast<int>(i * from / to); };
  const auto last = [](std::int64_t i, int from, int to) { return static_cast<int>(((i + 1) * from + to - 1) / to); };
  Image8 result(width, height, 1);
  for (int row = 0; row < height; ++row) {
    for (int column = 0; column < width; ++column) {
      std::uint8_t least = 255;
      for (int y = first(row, mask.height, height); y < last(row, mask.height, height); ++y) {
        for (int x = first(column, mask.width, width); x < last(column, mask.width, width); ++x) {
          least = std::min(least, *mask.at(x, y));
        }
      }
      *result.at(column, row) = least;
    }
  }
  return result;
}

bool Lens::is_pinhole() const {
  return model->is_pinhole_at_zero &&
         std::all_of(coefficients.begin(), coefficients.end(), [](double value) { return value == 0; });
}

Lens Lens::scaled(double sx, double sy) const {
  Lens scaled = *this;
  scaled.fx *= sx;
  scaled.cx *= sx;
  scaled.fy *= sy;
  scaled.cy *= sy;
  return scaled;
}

LensParams<double> Lens::params() const {
  LensParams<double> params;
  if (is_pinhole()) return params;
  params.kind = model->kind;
  for (std::size_t i = 0; i < coefficients.size(); ++i) params.k[model->places[i]] = coefficients[i];
  return params;
}

Camera Lens::pinhole(ImageSize size) const {
  return {size.width, size.height, fx, fy, cx, cy, {}, {}};
}

std::array<double, 2> distort(const Lens& lens, double x, double y) {
  const double* const k = lens.coefficients.data();
  if (lens.model->distort != nullptr) return lens.model->distort(k, x, y);
  const double factor = lens.model->radial_factor(k, std::sqrt(x * x + y * y));
  return {x * factor, y * factor};
}

double monotonic_radius(const Lens& lens, double limit) {
  // Steps far smaller than a pixel of an image whose corner is at `limit`; a turning point between two steps moves the
  // result by less than one step.
  constexpr int kSteps = 1 << 15;
  double before = 0;
  for (int i = 1; i <= kSteps; ++i) {
    const double r = limit * i / kSteps;
    const double distorted = r * lens.model->radial_factor(lens.coefficients.data(), r);
    if (!(distorted > before)) return limit * (i - 1) / kSteps;
    before = distorted;
  }
  return limit;
}

}  // namespace b3dgs
