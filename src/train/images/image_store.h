// The 8-bit photographs of the training views, ready before a step needs them.
//
// On a GPU, photographs stay in its memory within a budget ("resident"). The others are uploaded on a separate stream
// while earlier steps run. On a CPU, photographs stay in host memory within the limit of ImageMemory. Background
// threads read photographs ahead from disk that are not in host memory. It does not matter which views are resident,
// because every view is used once per epoch, so these are the first ones. Apart from buffers for the next few, each
// photograph is stored once.
#pragma once

#include <torch/types.h>

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "raster/args.h"
#include "scene/scene.h"

namespace b3dgs {

/// A training view with its photograph and masks on the device.
struct TrainView {
  std::string name;
  std::int32_t index = 0;  // in Scene::train
  CameraView camera{};
  torch::Tensor truth;       // [H, W, 3] uint8
  torch::Tensor valid;       // [H, W] uint8, 0 = pixel is ignored; undefined = all pixels count
  torch::Tensor empty;       // [H, W] uint8, 255 = must be empty (View::empty); undefined = no such pixel
  std::int64_t n_valid = 0;  // number of valid pixels
};

/// Returns image_cache_gb in bytes. For -1, this is half of the GPU memory that is free now, or of gpu_memory_gb if
/// that is less.
std::int64_t image_budget(double image_cache_gb, torch::Device device, double gpu_memory_gb = 0);

/// Number and size of the photographs by where they are stored, for messages.
struct ImagePlaces {
  struct Share {
    std::int64_t count = 0, bytes = 0;
  };
  Share on_device, in_memory, on_disk;  // GPU memory, host memory, and disk, from which they are read ahead
};

/// Returns "1200 on the GPU (6.15 GB), 390 in memory (2.00 GB), 1410 read ahead from disk (7.22 GB)".
std::string describe(const ImagePlaces& places);

/// Returns where the photographs of views are stored that are not on a GPU.
ImagePlaces places_of(const std::vector<View>& views);

/// Stores the photographs of the training views.
class ImageStore {
 public:
  static constexpr std::size_t kUploadAhead = 2;  // number of views uploaded while another one is in use

  /// Reads the resident photographs into device or host memory. Masks are on the device. Views that share a mask share
  /// its tensor. If the budget of a GPU is too small for all photographs, kUploadAhead + 1 upload slots are allocated
  /// in addition to the budget.
  /// @throws InputError for a photograph that cannot be read
  ImageStore(const std::vector<View>& views, torch::Device device, std::int64_t budget_bytes,
             const ProgressFn& progress = {});
  ~ImageStore();
  ImageStore(const ImageStore&) = delete;
  ImageStore& operator=(const ImageStore&) = delete;

  std::int32_t size() const { return static_cast<std::int32_t>(views_.size()); }
  std::int32_t n_resident() const { return n_resident_; }
  ImagePlaces places() const;

  /// Returns the view as take() does, but without its photograph if that is not resident.
  const TrainView& stored_view(std::int32_t index) const { return views_[static_cast<std::size_t>(index)]; }

  /// Returns how many `upcoming` views to pass to take(), 0 if all are resident.
  std::size_t n_upcoming_wanted() const;

  /// Returns the view, valid for work that is queued on the current stream before the next take(). `upcoming` are the
  /// views that will be taken next. The host waits if the photograph has not been read yet, and the stream waits for
  /// its upload.
  /// @throws InputError if this photograph cannot be read; other views can still be taken afterwards
  TrainView take(std::int32_t index, const std::vector<std::int32_t>& upcoming);

  /// Frees at least this many bytes of GPU memory, or all that photographs use. Views stop being resident, the last
  /// ones first, and move to host memory if its limit allows. The view from take() stays valid until the next take().
  /// Returns the number of bytes freed, which is 0 on the CPU, or if memory does not even suffice for the upload slots.
  std::int64_t release_resident(std::int64_t bytes);

 private:
  struct Streamed;
  /// Creates the streaming of the views that are not resident, and of all views from index `from` on.
  std::unique_ptr<Streamed> make_streamed(std::int32_t from) const;
  TrainView take_on_gpu(std::int32_t index, const std::vector<std::int32_t>& streamed);
  bool is_resident(std::int32_t index) const { return stored_view(index).truth.defined(); }

  torch::Device device_;
  std::vector<TrainView> views_;
  std::vector<std::shared_ptr<ViewImage>> images_;
  std::vector<std::shared_ptr<const Image8>> held_;  // on the CPU, the images that tensors of views_ point to
  std::int32_t n_resident_ = 0;
  std::unique_ptr<Streamed> streamed_;  // null if all views are resident
  // The streamed_ from before release_resident(), until the next take(), because the view in use may be in one of its
  // upload slots.
  std::unique_ptr<Streamed> retired_;
};

}  // namespace b3dgs
