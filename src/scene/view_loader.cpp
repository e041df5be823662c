#include "scene/view_loader.h"

#include <algorithm>
#include <atomic>
#include <fstream>
#include <map>
#include <mutex>
#include <numeric>
#include <tuple>

#include "check.h"
#include "parallel.h"
#include "scene/undistort.h"

namespace b3dgs {
namespace {

// Distorted images of one camera and size share one map and one mask. The map, eight bytes a pixel, is dropped after
// the last of them: scenes with a camera of its own for each image would need more memory for maps than for images.
class LensGroup {
 public:
  void expect_image() { ++images_left_; }

  LoadedImage undistort(const ViewSource& source, const Image8& image) {
    std::shared_ptr<const Undistorter> undistorter;
    std::shared_ptr<const Image8> valid;
    {
      std::lock_guard<std::mutex> lock(mutex_);
      if (!undistorter_) {
        undistorter_ = std::make_shared<Undistorter>(source.lens, source.file_size.width, source.file_size.height,
                                                     source.camera_place);
        valid_ = undistorter_->valid();
        if (valid_) valid_ = reduced_mask(*valid_, source.size);
      }
      undistorter = undistorter_;
      valid = valid_;
      if (--images_left_ == 0) undistorter_.reset();
    }
    return {std::make_shared<Image8>(resize_image(undistorter->apply(image), source.size.width, source.size.height)),
            valid};
  }

 private:
  static std::shared_ptr<const Image8> reduced_mask(const Image8& mask, ImageSize size) {
    return std::make_shared<Image8>(shrink_mask(mask, size.width, size.height));
  }

  std::mutex mutex_;
  std::size_t images_left_ = 0;
  std::shared_ptr<const Undistorter> undistorter_;
  std::shared_ptr<const Image8> valid_;
};

using GroupKey = std::tuple<std::uint32_t, int, int>;  // camera, width and height of the file

GroupKey key_of(const ViewSource& source) {
  return {source.camera_id, source.file_size.width, source.file_size.height};
}

// Bytes that can be had without swapping; 0 if the system does not say.
std::uint64_t available_memory() {
  std::ifstream info("/proc/meminfo");
  std::string key, unit;
  for (std::uint64_t kilobytes = 0; info >> key >> kilobytes; std::getline(info, unit)) {
    if (key == "MemAvailable:") return kilobytes * 1024;
  }
  return 0;
}

void check_memory(const std::vector<ViewSource>& sources) {
  std::uint64_t bytes = 0;
  for (const ViewSource& source : sources) {
    bytes += (source.lens.is_pinhole() ? 3 : 4) * static_cast<std::uint64_t>(source.size.width) * source.size.height;
  }
  const std::uint64_t available = available_memory();
  if (available == 0 || bytes < available) return;
  input_error("the images need ", (bytes >> 20) + 1, " MiB of memory, ", available >> 20,
              " MiB are available; train on smaller ones with -r 2, 4 or 8");
}

LoadedImage load_one(const ViewSource& source, bool white_background, LensGroup* group) {
  Image8 image = read_image(source.file, white_background);
  if (image.width != source.file_size.width || image.height != source.file_size.height) {
    input_error(source.file.string(), ": its header says ", source.file_size.width, " x ", source.file_size.height,
                " px, decoded it has ", image.width, " x ", image.height, "; the file is damaged");
  }
  if (group) return group->undistort(source, image);
  if (source.size.width != image.width || source.size.height != image.height) {
    image = resize_image(image, source.size.width, source.size.height);
  }
  return {std::make_shared<Image8>(std::move(image)), nullptr};
}

}  // namespace

std::vector<LoadedImage> load_view_images(const std::vector<ViewSource>& sources, bool white_background,
                                          const ProgressFn& progress) {
  check_memory(sources);
  std::map<GroupKey, LensGroup> groups;
  for (const ViewSource& source : sources) {
    if (!source.lens.is_pinhole()) groups[key_of(source)].expect_image();
  }
  // Camera by camera, so that few maps are alive at a time.
  std::vector<std::size_t> order(sources.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::stable_sort(order.begin(), order.end(),
                   [&](std::size_t a, std::size_t b) { return key_of(sources[a]) < key_of(sources[b]); });

  std::vector<LoadedImage> images(sources.size());
  std::mutex progress_mutex;
  std::size_t done = 0;
  std::atomic<bool> has_failed{false};  // the other threads stop too, instead of decoding the rest
  parallel_pool(static_cast<std::int64_t>(sources.size()), [&](std::int64_t task, int) {
    if (has_failed) return;
    const ViewSource& source = sources[order[task]];
    try {
      LensGroup* group = source.lens.is_pinhole() ? nullptr : &groups.at(key_of(source));
      images[order[task]] = load_one(source, white_background, group);
    } catch (...) {
      has_failed = true;
      throw;
    }
    std::lock_guard<std::mutex> lock(progress_mutex);
    ++done;
    if (progress) progress("loading images", done, sources.size());
  });
  return images;
}

}  // namespace b3dgs
