#include "train/image_store.h"

#include <algorithm>
#include <optional>
#include <utility>

#include "check.h"
#include "train/loss.h"
#include "train/pinhole_view.h"

#if B3DGS_TORCH_CUDA
#include "raster/torch_launch.h"
#include "train/cuda/image_uploader.h"
#include "train/upload_slots.h"
#endif

namespace b3dgs {
namespace {

std::int64_t bytes_of(const View& view) {
  return static_cast<std::int64_t>(view.image->pixels.size() + (view.valid ? view.valid->pixels.size() : 0));
}

torch::Tensor bytes_at(const std::uint8_t* bytes, torch::IntArrayRef sizes, torch::Device device) {
  // from_blob wants a pointer that it could write through; nothing does.
  return torch::from_blob(const_cast<std::uint8_t*>(bytes), sizes, torch::TensorOptions(torch::kUInt8).device(device));
}

/// All but the tensors.
TrainView describe_view(const View& view) {
  const int width = view.camera.width, height = view.camera.height;
  B3DGS_CHECK(view.image && view.image->channels == 3 && view.image->width == width && view.image->height == height,
              "view ", view.name, " has no RGB image of its camera's size, ", width, " x ", height);
  TrainView own;
  own.name = view.name;
  own.camera = to_pinhole_view(view.camera);
  own.n_valid = static_cast<std::int64_t>(width) * height;
  if (view.valid) {
    B3DGS_CHECK(view.valid->width == width && view.valid->height == height, "the mask of view ", view.name,
                " has another size than its image");
    own.n_valid = count_valid(view.valid->pixels.data(), own.n_valid);
  }
  return own;
}

/// Sets the tensors to bytes on a device: RGB first, then the mask if there is one.
void set_tensors(TrainView& view, const std::uint8_t* truth, const std::uint8_t* valid, torch::Device device) {
  const std::int64_t height = view.camera.height, width = view.camera.width;
  view.truth = bytes_at(truth, {height, width, 3}, device);
  if (valid != nullptr) view.valid = bytes_at(valid, {height, width}, device);
}

/// Copies the photograph to the device for good; on the CPU it stays where it is.
void make_resident(TrainView& view, const View& photograph, torch::Device device) {
  const std::uint8_t* const valid = photograph.valid ? photograph.valid->pixels.data() : nullptr;
  set_tensors(view, photograph.image->pixels.data(), valid, torch::kCPU);
  view.truth = view.truth.to(device);
  if (valid != nullptr) view.valid = view.valid.to(device);
}

}  // namespace

std::int64_t image_budget(double image_cache_gb, [[maybe_unused]] torch::Device device,
                          [[maybe_unused]] double gpu_memory_gb) {
  if (image_cache_gb >= 0) return static_cast<std::int64_t>(std::min(1e9 * image_cache_gb, 9e18));
#if B3DGS_TORCH_CUDA
  if (device.is_cuda()) {
    const double free = static_cast<double>(cuda::free_device_bytes());
    return static_cast<std::int64_t>((gpu_memory_gb > 0 ? std::min(free, 1e9 * gpu_memory_gb) : free) / 2);
  }
#endif
  return 0;  // a CPU's photographs stay where they are
}

#if B3DGS_TORCH_CUDA

struct ImageStore::Streamed {
  explicit Streamed(std::int64_t slot_bytes)
      : slots(static_cast<int>(kLookAhead) + 1), uploader(static_cast<int>(kLookAhead) + 1, slot_bytes) {}

  UploadSlots slots;
  cuda::ImageUploader uploader;
  std::vector<std::optional<int>> images;  // of the uploader, by view; none if it is resident
  std::vector<bool> has_mask;              // by view
  int slot_in_use = -1;

  bool holds(std::int32_t view) const { return images[static_cast<std::size_t>(view)].has_value(); }
};

#else

struct ImageStore::Streamed {};

#endif

ImageStore::~ImageStore() = default;

ImageStore::ImageStore(const std::vector<View>& views, torch::Device device, std::int64_t budget_bytes)
    : device_(device) {
  std::int64_t used = 0, largest_streamed = 0;
  std::vector<bool> stays;
  for (const View& view : views) {
    views_.push_back(describe_view(view));
    const std::int64_t own = bytes_of(view);
    stays.push_back(device.is_cpu() || used + own <= budget_bytes);
    if (stays.back()) {
      used += own;
      ++n_resident_;
      make_resident(views_.back(), view, device);
    } else {
      largest_streamed = std::max(largest_streamed, own);
    }
  }
  if (n_resident_ == size()) return;
#if B3DGS_TORCH_CUDA
  streamed_ = std::make_unique<Streamed>(largest_streamed);
  for (std::size_t i = 0; i < views.size(); ++i) {
    const View& view = views[i];
    streamed_->has_mask.push_back(view.valid != nullptr);
    streamed_->images.emplace_back();
    if (stays[i]) continue;
    streamed_->images.back() = view.valid ? streamed_->uploader.add({&view.image->pixels, &view.valid->pixels})
                                          : streamed_->uploader.add({&view.image->pixels});
  }
#else
  input_error("this build keeps photographs on the CPU only, found device ", device.str(), "; use --device cpu");
#endif
}

TrainView ImageStore::take(std::int32_t index, [[maybe_unused]] const std::vector<std::int32_t>& upcoming) {
  TrainView view = describe(index);
#if B3DGS_TORCH_CUDA
  if (streamed_ == nullptr) return view;
  Streamed& s = *streamed_;
  const cudaStream_t reader = torch_launch_context().stream;
  if (s.slot_in_use >= 0) s.uploader.release(std::exchange(s.slot_in_use, -1), reader);

  std::vector<std::int32_t> wanted;
  const auto want = [&](std::int32_t other) {
    if (s.holds(other) && std::find(wanted.begin(), wanted.end(), other) == wanted.end()) wanted.push_back(other);
  };
  want(index);
  for (std::size_t i = 0; i < std::min(kLookAhead, upcoming.size()); ++i) want(upcoming[i]);
  for (const auto [slot, other] : s.slots.assign(wanted)) {
    s.uploader.upload(*s.images[static_cast<std::size_t>(other)], slot);
  }
  if (!s.holds(index)) return view;
  s.slot_in_use = s.slots.slot_of(index);
  const std::uint8_t* const truth = s.uploader.acquire(s.slot_in_use, reader);
  const bool has_mask = s.has_mask[static_cast<std::size_t>(index)];
  const std::int64_t truth_bytes = 3 * std::int64_t{view.camera.height} * view.camera.width;
  set_tensors(view, truth, has_mask ? truth + truth_bytes : nullptr, device_);
#endif
  return view;
}

std::int64_t ImageStore::release_resident(std::int64_t) {
  return 0;  // what lies on the device stays there
}

}  // namespace b3dgs
