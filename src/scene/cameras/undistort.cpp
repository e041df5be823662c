#include "scene/cameras/undistort.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <limits>
#include <opencv2/imgproc.hpp>

#include "core/check.h"
#include "core/parallel.h"
#include "scene/cameras/camera_lens.h"

namespace b3dgs {
namespace {

std::int64_t map_bytes(const Camera& camera) {
  return std::int64_t{9} * camera.width * camera.height;  // two floats and the mask
}

}  // namespace

Undistorter::Undistorter(const Camera& camera, const std::string& place)
    : width_(camera.width), height_(camera.height), source_(std::size_t{2} * width_ * height_) {
  constexpr int kMaxSide = std::numeric_limits<short>::max() - 1;  // cv::remap's coordinates are 16-bit
  if (width_ > kMaxSide || height_ > kMaxSide) {
    input_error(place, ": images of ", width_, " x ", height_, " px are too large to undistort (expected at most ",
                kMaxSide, " px per side); run \"colmap image_undistorter\" and train on its output");
  }
  const double far_x = std::max(camera.cx, width_ - camera.cx) / camera.fx,
               far_y = std::max(camera.cy, height_ - camera.cy) / camera.fy;
  const double corner = std::hypot(far_x, far_y), max_radius = monotonic_radius(camera.lens, corner);
  if (max_radius < corner) fold_angle_ = std::atan(max_radius);
  auto valid = std::make_shared<Image8>(width_, height_, 1);
  std::atomic<std::int64_t> n_valid{0};
  parallel_pool(height_, [&](std::int64_t row, int) {
    std::int64_t n_valid_here = 0;
    for (int column = 0; column < width_; ++column) {
      const double x = (column + 0.5 - camera.cx) / camera.fx,
                   y = (static_cast<double>(row) + 0.5 - camera.cy) / camera.fy;
      const auto [xd, yd] = distort(camera.lens, x, y);
      const double u = camera.fx * xd + camera.cx, v = camera.fy * yd + camera.cy;  // centres at + 0.5, as in COLMAP
      const bool is_inside = u >= 0 && u <= width_ && v >= 0 && v <= height_ && std::hypot(x, y) <= max_radius;
      const std::size_t pixel = static_cast<std::size_t>(row) * width_ + column;
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
  if (n_valid < std::int64_t{width_} * height_) valid_ = std::move(valid);
}

template <class Value>
void Undistorter::apply_into(const Raster<Value>& image, Value* pixels) const {
  B3DGS_CHECK(image.width == width_ && image.height == height_, "an image of ", image.width, " x ", image.height,
              " for a map of ", width_, " x ", height_);
  const int type = CV_MAKETYPE(cv::DataType<Value>::depth, image.channels);
  // OpenCV only reads these two, but its Mat has no const form.
  const cv::Mat from(height_, width_, type, const_cast<Value*>(image.pixels.data()));
  const cv::Mat map(height_, width_, CV_32FC2, const_cast<float*>(source_.data()));
  cv::Mat to(height_, width_, type, pixels);
  // Border pixels are replicated because a source within half a pixel of the edge is still inside the photograph.
  cv::remap(from, to, map, cv::noArray(), cv::INTER_LINEAR, cv::BORDER_REPLICATE);
  const auto n = static_cast<std::size_t>(image.channels);
  for (std::size_t i = 0; valid_ && i < valid_->pixels.size(); ++i) {
    if (valid_->pixels[i] == 0) std::fill_n(pixels + n * i, n, Value{0});
  }
}
template void Undistorter::apply_into(const Image8&, std::uint8_t*) const;
template void Undistorter::apply_into(const Depth16&, std::uint16_t*) const;

int UndistorterCache::add_group(const Camera& camera, const std::string& place) {
  groups_.push_back(std::make_unique<Group>());
  groups_.back()->camera = camera;
  groups_.back()->place = place;
  return static_cast<int>(groups_.size()) - 1;
}

std::int64_t UndistorterCache::most_kept_bytes() const {
  std::int64_t bytes = 0;
  for (const auto& group : groups_) bytes += map_bytes(group->camera);
  return std::min(bytes, max_bytes_);
}

std::shared_ptr<const Undistorter> UndistorterCache::get(int group_number) {
  Group& group = *groups_.at(static_cast<std::size_t>(group_number));
  const std::lock_guard<std::mutex> building(group.build_mutex);
  std::unique_lock<std::mutex> lock(mutex_);
  if (const auto kept = std::find(kept_.begin(), kept_.end(), &group); kept != kept_.end()) {
    std::rotate(kept, kept + 1, kept_.end());
    return group.map;
  }
  lock.unlock();
  auto map = std::make_shared<const Undistorter>(group.camera, group.place);
  const std::int64_t bytes = map_bytes(group.camera);
  if (bytes > max_bytes_) return map;
  lock.lock();
  while (kept_bytes_ + bytes > max_bytes_) {
    kept_bytes_ -= map_bytes(kept_.front()->camera);
    kept_.front()->map.reset();
    kept_.erase(kept_.begin());
  }
  group.map = map;
  kept_.push_back(&group);
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

}  // namespace b3dgs
