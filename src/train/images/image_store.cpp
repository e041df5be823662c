#include "train/images/image_store.h"

#include <algorithm>
#include <map>
#include <new>
#include <utility>

#include "core/check.h"
#include "core/text.h"
#include "model/raster_input.h"
#include "raster/torch/torch_cuda.h"
#include "scene/view_image.h"
#include "train/images/image_reader.h"
#include "train/loss/loss.h"

#if B3DGS_TORCH_CUDA
#include "train/images/image_uploader.h"
#endif

namespace b3dgs {
namespace {

using Indices = std::vector<std::int32_t>;
using Images = std::vector<std::shared_ptr<const ViewImage>>;

torch::Tensor bytes_at(const std::uint8_t* bytes, torch::IntArrayRef sizes, torch::Device device) {
  // from_blob takes a non-const pointer, but nothing writes to these tensors.
  return torch::from_blob(const_cast<std::uint8_t*>(bytes), sizes, torch::TensorOptions(torch::kUInt8).device(device));
}

torch::Tensor truth_at(const std::uint8_t* rgb, const TrainView& view, torch::Device device) {
  return bytes_at(rgb, {view.camera.height, view.camera.width, 3}, device);
}

/// Returns the view without its tensors.
TrainView make_train_view(const View& view) {
  const int width = view.camera.width, height = view.camera.height;
  B3DGS_CHECK(view.image && view.image->size().width == width && view.image->size().height == height, "view ",
              view.name, " has no RGB image of the size of its camera, ", width, " x ", height);
  TrainView train_view;
  train_view.name = view.name;
  train_view.camera = to_camera_view(view.camera);
  train_view.n_valid = static_cast<std::int64_t>(width) * height;
  if (view.valid) {
    B3DGS_CHECK(view.valid->width == width && view.valid->height == height, "the mask of view ", view.name,
                " differs in size from its image");
    train_view.n_valid = count_valid(view.valid->pixels.data(), train_view.n_valid);
  }
  return train_view;
}

void add(ImagePlaces::Share& share, const ViewImage& image) {
  ++share.count;
  share.bytes += image.n_bytes();
}

}  // namespace

std::int64_t image_budget(double image_cache_gb, torch::Device device, double gpu_memory_gb) {
  if (image_cache_gb >= 0) return static_cast<std::int64_t>(std::min(1e9 * image_cache_gb, 9e18));
  if (!kTorchHasCuda || device.is_cpu()) return 0;  // photographs are in host memory
  const auto free = static_cast<double>(device_memory_size().free);
  return static_cast<std::int64_t>((gpu_memory_gb > 0 ? std::min(free, 1e9 * gpu_memory_gb) : free) / 2);
}

std::string describe(const ImagePlaces& places) {
  std::string text;
  const auto say = [&](const ImagePlaces::Share& share, const char* where) {
    if (share.count == 0) return;
    text += detail::concat(text.empty() ? "" : ", ", share.count, " ", where, " (", format_bytes(share.bytes), ")");
  };
  say(places.on_device, "on the GPU");
  say(places.in_memory, "in memory");
  say(places.on_disk, "read ahead from disk");
  return text.empty() ? "none" : text;
}

ImagePlaces places_of(const std::vector<View>& views) {
  ImagePlaces places;
  for (const View& view : views) add(view.image->held() ? places.in_memory : places.on_disk, *view.image);
  return places;
}

/// Streams views that are not resident, with reading threads and, on a GPU, an uploader.
struct ImageStore::Streamed {
  explicit Streamed(const Images& images) : buffers(images) {}

  ImageBuffers buffers;
#if B3DGS_TORCH_CUDA
  std::unique_ptr<cuda::ImageUploader> uploader;  // has the buffers in pinned memory
  UploadSlots slots{static_cast<int>(kUploadAhead) + 1};
  int slot_in_use = -1;
#endif
  std::unique_ptr<ImageReader> reader;  // declared last, so that it ends before its buffers are freed
};

ImageStore::~ImageStore() = default;

ImageStore::ImageStore(const std::vector<View>& views, torch::Device device, std::int64_t budget_bytes,
                       const ProgressFn& progress)
    : device_(device) {
  std::map<const Image8*, torch::Tensor> masks;
  std::int64_t used = 0;
  for (const View& view : views) {
    TrainView& train_view = views_.emplace_back(make_train_view(view));
    train_view.index = size() - 1;
    images_.push_back(view.image);
    const auto on_device = [&](const std::shared_ptr<const Image8>& mask) {
      if (!mask) return torch::Tensor();
      torch::Tensor& tensor = masks[mask.get()];
      if (!tensor.defined()) {
        tensor = bytes_at(mask->pixels.data(), {mask->height, mask->width}, torch::kCPU).to(device);
        used += tensor.numel();
      }
      return tensor;
    };
    train_view.valid = on_device(view.valid);
    train_view.empty = on_device(view.empty);
  }
  if (device.is_cpu()) {
    hold_images(views, progress);
    for (std::size_t i = 0; i < views.size(); ++i) {
      held_.push_back(images_[i]->held());
      if (!held_[i]) continue;
      views_[i].truth = truth_at(held_[i]->pixels.data(), views_[i], device);
      ++n_resident_;
    }
  } else {
    std::vector<std::size_t> resident;
    Images resident_images;
    std::vector<View> others;
    for (std::size_t i = 0; i < views.size(); ++i) {
      if (used + images_[i]->n_bytes() > budget_bytes) {
        others.push_back(views[i]);
        continue;
      }
      used += images_[i]->n_bytes();
      resident.push_back(i);
      resident_images.push_back(images_[i]);
    }
    // Photographs that are read from disk here do not stay in host memory.
    read_in_order(resident_images, reading_threads(ReadingLoad::kNothing), [&](std::size_t done, const auto* rgb) {
      TrainView& view = views_[resident[done]];
      view.truth = truth_at(rgb, view, torch::kCPU).to(device);
      ++n_resident_;
      if (progress) progress("loading images", done + 1, resident.size());
    });
    hold_images(others, progress);
  }
  if (n_resident_ < size()) streamed_ = make_streamed(size());
}

std::unique_ptr<ImageStore::Streamed> ImageStore::make_streamed(std::int32_t from) const {
  const Images all(images_.begin(), images_.end());
  Images streamed_images;
  for (std::int32_t i = 0; i < size(); ++i) {
    if (!is_resident(i) || i >= from) streamed_images.push_back(all[static_cast<std::size_t>(i)]);
  }
  auto streamed = std::make_unique<Streamed>(streamed_images);
  ImageReader::Setup setup;
  setup.images = all;
  setup.n_threads = reading_threads(device_.is_cpu() ? ReadingLoad::kCpuTraining : ReadingLoad::kGpuTraining);
  if (device_.is_cpu()) setup.buffers = streamed->buffers.allocate();
#if B3DGS_TORCH_CUDA
  if (device_.is_cuda()) {
    streamed->uploader = std::make_unique<cuda::ImageUploader>(static_cast<int>(kUploadAhead) + 1,
                                                               streamed->buffers.count(), streamed->buffers.n_bytes());
    setup.buffers = streamed->uploader->staging();
    setup.before_write = [uploader = streamed->uploader.get()](int buffer) { uploader->wait_for_upload_of(buffer); };
  }
#endif
  streamed->reader = std::make_unique<ImageReader>(std::move(setup));
  return streamed;
}

ImagePlaces ImageStore::places() const {
  ImagePlaces places;
  for (std::int32_t i = 0; i < size(); ++i) {
    const ViewImage& image = *images_[static_cast<std::size_t>(i)];
    const bool is_on_gpu = !device_.is_cpu() && is_resident(i);
    add(is_on_gpu ? places.on_device : image.held() ? places.in_memory : places.on_disk, image);
  }
  return places;
}

std::size_t ImageStore::n_upcoming_wanted() const {
  if (streamed_ == nullptr) return 0;
  // Asks for enough views to find an image for each buffer although some of the views are resident.
  constexpr std::int64_t kMostPerBuffer = 4;
  const std::int64_t n_streamed = size() - n_resident_, n_buffers = streamed_->reader->n_buffers();
  const std::int64_t wanted = (n_buffers * size() + n_streamed - 1) / n_streamed;
  return std::max(kUploadAhead, static_cast<std::size_t>(std::min(wanted, kMostPerBuffer * n_buffers)));
}

TrainView ImageStore::take(std::int32_t index, const Indices& upcoming) {
  retired_.reset();
  if (streamed_ == nullptr) return stored_view(index);
  Indices streamed;
  const auto want = [&](std::int32_t view) {
    if (!is_resident(view)) streamed.push_back(view);
  };
  want(index);
  for (const std::int32_t view : upcoming) want(view);
#if B3DGS_TORCH_CUDA
  if (device_.is_cuda()) return take_on_gpu(index, streamed);
#endif
  TrainView view = stored_view(index);
  ImageReader& reader = *streamed_->reader;
  reader.expect(streamed);
  if (!is_resident(index)) view.truth = truth_at(reader.bytes(reader.wait(index)), view, device_);
  return view;
}

#if B3DGS_TORCH_CUDA

TrainView ImageStore::take_on_gpu(std::int32_t index, const Indices& streamed) {
  TrainView view = stored_view(index);
  Streamed& s = *streamed_;
  ImageReader& reader = *s.reader;
  const cudaStream_t stream = torch_stream();
  if (s.slot_in_use >= 0) s.uploader->release(std::exchange(s.slot_in_use, -1), stream);

  // Selects this view and the next ones, up to the first one that is neither on the device nor ready for upload.
  const auto is_here = [&](std::int32_t other) { return s.slots.slot_of(other) >= 0; };
  if (!is_resident(index) && !is_here(index)) {
    reader.expect(streamed);
    reader.wait(index);
  }
  Indices wanted;
  for (const std::int32_t other : streamed) {
    if (wanted.size() > kUploadAhead || !(is_here(other) || reader.is_ready(other))) break;
    if (std::find(wanted.begin(), wanted.end(), other) == wanted.end()) wanted.push_back(other);
  }
  for (const auto [slot, other] : s.slots.assign(wanted)) {
    const int buffer = reader.wait(other);
    s.uploader->upload(buffer, images_[static_cast<std::size_t>(other)]->n_bytes(), slot);
  }
  // Buffers of uploaded photographs may be reused, because before_write makes the reading thread wait for the upload.
  Indices unread;
  for (const std::int32_t other : streamed) {
    if (!is_here(other)) unread.push_back(other);
  }
  reader.expect(unread);
  if (is_resident(index)) return view;
  s.slot_in_use = s.slots.slot_of(index);
  view.truth = truth_at(s.uploader->acquire(s.slot_in_use, stream), view, device_);
  return view;
}

#endif

std::int64_t ImageStore::release_resident(std::int64_t bytes) {
  if (!kTorchHasCuda || device_.is_cpu()) return 0;
  Indices released;
  std::int64_t freed = 0;
  for (std::int32_t i = size() - 1; i >= 0 && freed < bytes; --i) {
    if (!is_resident(i)) continue;
    released.push_back(i);
    freed += images_[static_cast<std::size_t>(i)]->n_bytes();
  }
  if (released.empty()) return 0;
  // Allocates the streaming before photographs are released, because there may be too little memory for its buffers.
  release_unused_torch_memory();  // because LibTorch does not allocate the upload slots
  std::unique_ptr<Streamed> replacement;
  try {
    replacement = make_streamed(released.back());
  } catch (const OutOfMemoryError&) {
    return 0;  // the caller tries other remedies, and reports if none helps
  } catch (const std::bad_alloc&) {
    return 0;
  }
  for (const std::int32_t i : released) {
    TrainView& view = views_[static_cast<std::size_t>(i)];
    ViewImage& image = *images_[static_cast<std::size_t>(i)];
    if (!image.held() && image.memory() != nullptr && image.memory()->try_hold(image.n_bytes())) {
      auto copy = std::make_shared<Image8>(image.size().width, image.size().height, 3);
      truth_at(copy->pixels.data(), view, torch::kCPU).copy_(view.truth);
      image.hold(std::move(copy));
    }
    view.truth = torch::Tensor();
    --n_resident_;
  }
  release_unused_torch_memory();
  if (retired_ == nullptr) retired_ = std::move(streamed_);
  streamed_ = std::move(replacement);
  return freed;
}

}  // namespace b3dgs
