#include "scene/cameras/undistort.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <limits>
#include <opencv2/imgproc.hpp>

#include "core/check.h"
#include "core/parallel.h"

namespace b3dgs {

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
  const std::int64_t n_pixels = std::int64_t{width} * height;
  valid_share_ = static_cast<double>(n_valid) / static_cast<double>(n_pixels);
  if (n_valid < n_pixels) valid_ = std::move(valid);
}

Image8 Undistorter::apply(const Image8& image) const {
  Image8 result(width_, height_, 3);
  apply_into(image, result.pixels.data());
  return result;
}

void Undistorter::apply_into(const Image8& image, std::uint8_t* rgb) const {
  B3DGS_CHECK(image.width == width_ && image.height == height_ && image.channels == 3, "an image of ", image.width,
              " x ", image.height, " x ", image.channels, " for a map of ", width_, " x ", height_);
  // OpenCV only reads these two; its Mat has no const form.
  const cv::Mat from(height_, width_, CV_8UC3, const_cast<std::uint8_t*>(image.pixels.data()));
  const cv::Mat map(height_, width_, CV_32FC2, const_cast<float*>(source_.data()));
  cv::Mat to(height_, width_, CV_8UC3, rgb);
  // Border pixels are replicated because a source within half a pixel of the edge is still inside the photograph.
  cv::remap(from, to, map, cv::noArray(), cv::INTER_LINEAR, cv::BORDER_REPLICATE);
  if (valid_) {
    for (std::size_t i = 0; i < valid_->pixels.size(); ++i) {
      if (valid_->pixels[i] == 0) std::fill_n(rgb + 3 * i, 3, std::uint8_t{0});
    }
  }
}

Depth16 Undistorter::apply(const Depth16& map) const {
  B3DGS_CHECK(map.width == width_ && map.height == height_, "a depth map of ", map.width, " x ", map.height,
              " for a map of ", width_, " x ", height_);
  Depth16 result(width_, height_);
  const cv::Mat from(height_, width_, CV_16UC1, const_cast<std::uint16_t*>(map.values.data()));
  const cv::Mat sources(height_, width_, CV_32FC2, const_cast<float*>(source_.data()));
  cv::Mat to(height_, width_, CV_16UC1, result.values.data());
  cv::remap(from, to, sources, cv::noArray(), cv::INTER_LINEAR, cv::BORDER_REPLICATE);
  return result;
}

Image8 Undistorter::apply_to_mask(const Image8& mask) const {
  B3DGS_CHECK(mask.width == width_ && mask.height == height_ && mask.channels == 1, "a mask of ", mask.width, " x ",
              mask.height, " x ", mask.channels, " for a map of ", width_, " x ", height_);
  Image8 result(width_, height_, 1);
  const cv::Mat from(height_, width_, CV_8UC1, const_cast<std::uint8_t*>(mask.pixels.data()));
  const cv::Mat map(height_, width_, CV_32FC2, const_cast<float*>(source_.data()));
  cv::Mat to(height_, width_, CV_8UC1, result.pixels.data());
  cv::remap(from, to, map, cv::noArray(), cv::INTER_LINEAR, cv::BORDER_REPLICATE);
  for (std::size_t i = 0; valid_ && i < result.pixels.size(); ++i) {
    if (valid_->pixels[i] == 0) result.pixels[i] = 0;
  }
  return result;
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
          least = std::min(least, mask.pixels[static_cast<std::size_t>(y) * mask.width + x]);
        }
      }
      result.pixels[static_cast<std::size_t>(row) * width + column] = least;
    }
  }
  return result;
}

}  // namespace b3dgs
