#include "scene/view_image.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <map>
#include <mutex>
#include <set>
#include <tuple>

#include "core/check.h"
#include "core/host_memory.h"
#include "core/parallel.h"
#include "core/vec.h"
#include "scene/cameras/camera_lens.h"
#include "scene/images/image_folder.h"

namespace b3dgs {
namespace {

constexpr std::int64_t kMapShare = 8;  // undistortion maps get an eighth of the memory

// Returns the warning about a lens that shows only a part of the image, the part in `mask`, or "". `end` is the angle
// where its formula or its use ends inside the image, in radians, or 0.
std::string lens_warning(const ViewSource& source, double end, const Image8& mask) {
  if (source.camera.lens.kind == LensKind::kEquirectangular) return "";
  const auto n = static_cast<std::int64_t>(mask.pixels.size()),
             n_left_out = std::count(mask.pixels.begin(), mask.pixels.end(), 0);
  // With lenses of the other kinds, an image may be a circle.
  const bool is_wrong =
      2 * n_left_out > n && (source.camera.is_pinhole() || source.camera.lens.kind == LensKind::kDistorted);
  if (end == 0 && !is_wrong) return "";
  return detail::concat(
      source.camera_place, ": ",
      end > 0 ? detail::concat("the lens is used up to ", std::round(10 * end / kDegree) / 10,
                               " degrees from the axis, less than the image shows; ")
              : "",
      std::max<std::int64_t>(1, 100 * n_left_out / n), "% of the pixels are not covered and do not count",
      is_wrong ? "; the lens coefficients are probably wrong: correct them or reconstruct the scene again" : "");
}

// Photographs with the same lens and file size share a group, a mask and a warning.
void assign_lens_groups(std::vector<ViewSource>& sources, UndistorterCache& cache) {
  std::map<std::tuple<std::uint32_t, int, int>, const ViewSource*> first;  // by camera, width and height of the file
  for (ViewSource& source : sources) {
    const bool keeps_lens = !source.camera.is_pinhole();
    if (!keeps_lens && source.file_camera.is_pinhole()) continue;
    const auto [known, is_new] =
        first.try_emplace({source.camera_id, source.file_size.width, source.file_size.height}, &source);
    if (!is_new) {
      source.lens_group = known->second->lens_group;
      source.valid = known->second->valid;
      source.warning = known->second->warning;
    } else if (keeps_lens) {
      source.valid = lens_mask(source.camera);
      if (source.valid) source.warning = lens_warning(source, source.camera.lens.max_angle, *source.valid);
    } else {
      source.lens_group = cache.add_group(source.file_camera, source.camera_place);
      const std::shared_ptr<const Undistorter> undistorter = cache.get(source.lens_group);
      if (const Image8* valid = undistorter->valid().get()) {
        source.valid = std::make_shared<Image8>(shrink_mask(*valid, source.size.width, source.size.height));
        source.warning = lens_warning(source, undistorter->fold_angle(), *valid);
      }
    }
  }
}

bool has_only(const Image8& mask, std::uint8_t value) {
  return std::all_of(mask.pixels.begin(), mask.pixels.end(), [&](std::uint8_t pixel) { return pixel == value; });
}

// Returns the pixels of the view that consist only of light (or dark) pixels of the mask and that the photograph shows.
std::shared_ptr<const Image8> pixels_within(const Image8& mask, const ViewSource& source) {
  auto within = std::make_shared<Image8>(shrink_mask(mask, source.size.width, source.size.height));
  for (std::size_t i = 0; i < within->pixels.size(); ++i) {
    const bool is_valid = !source.valid || source.valid->pixels[i] != 0;
    within->pixels[i] = is_valid && within->pixels[i] == 255 ? 255 : 0;
  }
  return within;
}

// Reads the mask of a photograph, which is undistorted and reduced like it. Pixels on the border of light and dark are
// neither valid nor empty.
void read_mask_of(ViewSource& source, const SceneOptions& options, UndistorterCache& cache) {
  Image8 mask = read_mask(source.mask_file, source.file_size, options.invert_masks, source.orientation);
  if (source.lens_group >= 0) mask = cache.get(source.lens_group)->apply(mask);
  std::shared_ptr<const Image8> valid = pixels_within(mask, source), empty;
  if (options.empty_background) {
    for (std::uint8_t& pixel : mask.pixels) pixel = static_cast<std::uint8_t>(255 - pixel);
    empty = pixels_within(mask, source);
  }
  source.is_masked_out = has_only(*valid, 0);
  if (source.valid || !has_only(*valid, 255)) source.valid = std::move(valid);
  if (empty && !has_only(*empty, 0)) source.empty = std::move(empty);
}

struct ByPixels {
  bool operator()(const std::shared_ptr<const Image8>& a, const std::shared_ptr<const Image8>& b) const {
    return std::tie(a->width, a->pixels) < std::tie(b->width, b->pixels);
  }
};

void read_masks(std::vector<ViewSource>& sources, const SceneOptions& options, UndistorterCache& cache) {
  parallel_pool(static_cast<std::int64_t>(sources.size()), [&](std::int64_t i, int) {
    ViewSource& source = sources[static_cast<std::size_t>(i)];
    if (!source.mask_file.empty()) read_mask_of(source, options, cache);
  });
  // Masks with the same pixels share memory, for example those of a camera that shows a part of its vehicle.
  std::set<std::shared_ptr<const Image8>, ByPixels> different;
  for (ViewSource& source : sources) {
    if (source.mask_file.empty()) continue;
    for (std::shared_ptr<const Image8>* mask : {&source.valid, &source.empty}) {
      if (*mask) *mask = *different.insert(*mask).first;
    }
  }
}

}  // namespace

std::shared_ptr<SceneImages> prepare_images(std::vector<ViewSource>& sources, const SceneOptions& options) {
  ImageMemory::Plan plan;
  plan.limit = image_memory_limit(options.host_memory_gb, available_host_memory());
  plan.n_readers = options.n_readers;
  auto undistorters = std::make_unique<UndistorterCache>(plan.limit / kMapShare);
  assign_lens_groups(sources, *undistorters);
  read_masks(sources, options, *undistorters);
  plan.fixed = undistorters->most_kept_bytes();
  std::set<const Image8*> masks;
  for (const ViewSource& source : sources) {
    const std::int64_t bytes = std::int64_t{3} * source.size.width * source.size.height;
    plan.photographs += bytes;
    plan.largest = std::max(plan.largest, bytes);
    for (const Image8* mask : {source.valid.get(), source.empty.get()}) {
      if (mask != nullptr && masks.insert(mask).second) plan.fixed += static_cast<std::int64_t>(mask->pixels.size());
    }
  }
  return std::make_shared<SceneImages>(plan, std::move(undistorters), options.white_background);
}

ViewImage::ViewImage(Image8 image) {
  B3DGS_CHECK(image.channels == 3, "expected 3 channels, found ", image.channels);
  source_.size = source_.file_size = image.size();
  held_ = std::make_shared<const Image8>(std::move(image));
}

std::shared_ptr<const Image8> ViewImage::read() const {
  if (auto image = held()) return image;
  auto image = std::make_shared<Image8>(size().width, size().height, 3);
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

Image8 ViewImage::decode() const {
  const auto [width, height] = source_.file_size;
  const bool is_turned = source_.orientation != 1;
  Image8 image(is_turned ? height : width, is_turned ? width : height, 3);
  read_image_into(source_.file, shared_->white_background, image.size(), image.pixels.data());
  return is_turned ? turn_upright(image, source_.orientation) : image;
}

void ViewImage::decode_into(std::uint8_t* rgb) const {
  const bool is_pinhole = source_.lens_group < 0;
  if (is_pinhole && !source_.is_reduced() && source_.orientation == 1) {
    return read_image_into(source_.file, shared_->white_background, size(), rgb);
  }
  Image8 image = decode();
  if (!is_pinhole) {
    const std::shared_ptr<const Undistorter> undistorter = shared_->undistorters->get(source_.lens_group);
    if (!source_.is_reduced()) return undistorter->apply_into(image, rgb);
    image = undistorter->apply(image);
  }
  resize_into(image, size(), rgb);
}

std::optional<Image8> ViewImage::read_alpha() const {
  if (!shared_) return std::nullopt;
  std::optional<Image8> alpha = b3dgs::read_alpha(source_.file);
  if (!alpha) return std::nullopt;
  if (source_.orientation != 1) alpha = turn_upright(*alpha, source_.orientation);
  if (source_.lens_group >= 0) alpha = shared_->undistorters->get(source_.lens_group)->apply(*alpha);
  return resize_image(*alpha, size().width, size().height);
}

Depth16 ViewImage::read_depth(const std::filesystem::path& file) const {
  const ImageSize photograph = source_.file_size;
  Depth16 map = read_depth_map(file);
  if (is_turned(map.size(), photograph) && source_.orientation != 1) map = turn_upright(map, source_.orientation);
  if (!has_same_aspect(map.size(), photograph)) {
    input_error(file.string(), ": expected the aspect ratio of its photograph, ", photograph.width, " x ",
                photograph.height, " px, found a depth map of ", map.width, " x ", map.height, " px");
  }
  if (source_.lens_group >= 0) {
    map = shared_->undistorters->get(source_.lens_group)->apply(resize_image(map, photograph.width, photograph.height));
  }
  return resize_image(map, size().width, size().height);
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
