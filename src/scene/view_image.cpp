#include "scene/view_image.h"

#include <algorithm>
#include <atomic>
#include <cstdlib>

#include "core/check.h"
#include "core/parallel.h"
#include "scene/images/image_io.h"

namespace b3dgs {

ViewImage::ViewImage(Image8 image) : size_{image.width, image.height} {
  B3DGS_CHECK(image.channels == 3, "expected 3 channels, found ", image.channels);
  held_ = std::make_shared<const Image8>(std::move(image));
}

ViewImage::ViewImage(ViewSource source, std::shared_ptr<SceneImages> shared)
    : size_(source.size), source_(std::move(source)), shared_(std::move(shared)) {}

std::shared_ptr<const Image8> ViewImage::held() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return held_;
}

void ViewImage::hold(std::shared_ptr<const Image8> image) {
  const std::lock_guard<std::mutex> lock(mutex_);
  held_ = std::move(image);
}

std::shared_ptr<const Image8> ViewImage::read() const {
  if (auto image = held()) return image;
  auto image = std::make_shared<Image8>(size_.width, size_.height, 3);
  decode_into(image->pixels.data());
  return image;
}

void ViewImage::read_into(std::uint8_t* rgb) const {
  if (const auto image = held()) {
    std::copy(image->pixels.begin(), image->pixels.end(), rgb);
  } else {
    decode_into(rgb);
  }
}

void ViewImage::decode_into(std::uint8_t* rgb) const {
  const bool is_pinhole = source_.lens_group < 0;
  if (is_pinhole && !source_.is_reduced()) {
    read_image_into(source_.file, shared_->white_background, source_.file_size, rgb);
    return;
  }
  Image8 image(source_.file_size.width, source_.file_size.height, 3);
  read_image_into(source_.file, shared_->white_background, source_.file_size, image.pixels.data());
  if (!is_pinhole) {
    const std::shared_ptr<const Undistorter> undistorter = shared_->undistorters->get(source_.lens_group);
    if (!source_.is_reduced()) {
      undistorter->apply_into(image, rgb);
      return;
    }
    image = undistorter->apply(image);
  }
  resize_image_into(image, size_, rgb);
}

std::optional<Image8> ViewImage::read_alpha() const {
  if (!shared_) return std::nullopt;
  std::optional<Image8> alpha = b3dgs::read_alpha(source_.file);
  if (!alpha) return std::nullopt;
  if (source_.lens_group >= 0) alpha = shared_->undistorters->get(source_.lens_group)->apply_to_mask(*alpha);
  return source_.is_reduced() ? resize_image(*alpha, size_.width, size_.height) : *alpha;
}

Depth16 ViewImage::read_depth(const std::filesystem::path& file) const {
  const ImageSize photograph = shared_ ? source_.file_size : size_;
  Depth16 map = read_depth_map(file);
  // Equal up to the rounding of one side by less than a pixel.
  const std::int64_t across = std::int64_t{map.width} * photograph.height,
                     down = std::int64_t{map.height} * photograph.width;
  if (std::abs(across - down) >= std::max(photograph.width, photograph.height)) {
    input_error(file.string(), ": expected the aspect ratio of its photograph, ", photograph.width, " x ",
                photograph.height, " px, found a depth map of ", map.width, " x ", map.height, " px");
  }
  if (source_.lens_group >= 0) {
    map = shared_->undistorters->get(source_.lens_group)->apply(resize_depth_map(map, photograph));
  }
  return resize_depth_map(map, size_);
}

void hold_images(const std::vector<View>& views, const ProgressFn& progress) {
  std::vector<ViewImage*> chosen;
  for (const View& view : views) {
    if (view.image->held()) continue;
    if (view.image->memory()->try_hold(view.image->n_bytes())) chosen.push_back(view.image.get());
  }
  std::stable_sort(chosen.begin(), chosen.end(),
                   [](const ViewImage* a, const ViewImage* b) { return a->lens_group() < b->lens_group(); });
  std::mutex progress_mutex;
  std::size_t done = 0;
  std::atomic<bool> has_failed{false};  // makes the other threads stop too
  try {
    parallel_pool(static_cast<std::int64_t>(chosen.size()), [&](std::int64_t task, int) {
      if (has_failed) return;
      ViewImage& image = *chosen[static_cast<std::size_t>(task)];
      try {
        image.hold(image.read());
      } catch (...) {
        has_failed = true;
        throw;
      }
      const std::lock_guard<std::mutex> lock(progress_mutex);
      ++done;
      if (progress) progress("loading images", done, chosen.size());
    });
  } catch (...) {
    for (const ViewImage* image : chosen) {
      if (!image->held()) image->memory()->release_held(image->n_bytes());
    }
    throw;
  }
}

}  // namespace b3dgs
