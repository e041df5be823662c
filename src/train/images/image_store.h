// The photographs of the training views, 8-bit, where a step can read them without waiting. On a GPU they stay in its
// memory within a budget of bytes; elsewhere they stay in host memory as long as ImageMemory has room. The others are
// read ahead from disk by threads, and for a GPU all that do not stay there are uploaded on a stream of their own while
// earlier steps are under way. Every view is taken once in each pass over the scene, so which ones stay makes no
// difference: the first ones do. There is one copy of a photograph, besides the few that are under way.
#pragma once

#include <torch/types.h>

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "raster/args.h"
#include "scene/scene.h"

namespace b3dgs {

struct TrainView {
  std::string name;
  PinholeView camera{};
  torch::Tensor truth;       // [H, W, 3] uint8
  torch::Tensor valid;       // [H, W] uint8, 0 where the photograph does not count; undefined: all of it counts
  std::int64_t n_valid = 0;  // px
};

/// Bytes for --image_cache_gb on a device; for -1 half of what a GPU has free now, or of gpu_memory_gb if that is less.
std::int64_t image_budget(double image_cache_gb, torch::Device device, double gpu_memory_gb = 0);

/// Where photographs are, for the user.
struct ImagePlaces {
  struct Share {
    std::int64_t count = 0, bytes = 0;
  };
  Share on_device, in_memory, on_disk;  // the device being a GPU; on disk: read ahead
};

/// "1200 on the GPU (6.15 GB), 390 in memory (2.00 GB), 1410 read ahead from disk (7.22 GB)"
std::string describe(const ImagePlaces& places);

/// Of views that are not on a GPU.
ImagePlaces places_of(const std::vector<View>& views);

class ImageStore {
 public:
  static constexpr std::size_t kLookAhead = 2;  // views that are uploaded while another is in use

  /// Reads the photographs that stay, into the device or host memory. Masks are on the device, one for the views that
  /// share it. On a GPU kLookAhead + 1 photographs lie there beyond the budget, if it is too small for all.
  /// @throws InputError for a photograph that cannot be read
  ImageStore(const std::vector<View>& views, torch::Device device, std::int64_t budget_bytes,
             const ProgressFn& progress = {});
  ~ImageStore();
  ImageStore(const ImageStore&) = delete;
  ImageStore& operator=(const ImageStore&) = delete;

  std::int32_t size() const { return static_cast<std::int32_t>(views_.size()); }
  std::int32_t n_resident() const { return n_resident_; }
  ImagePlaces places() const;

  /// Name, camera, mask and n_valid; the photograph is that of take() where the view is resident, else undefined.
  const TrainView& describe(std::int32_t index) const { return views_[static_cast<std::size_t>(index)]; }

  /// Views of `upcoming` that take() makes use of; 0 if all are resident.
  std::size_t look_ahead() const;

  /// The view for work that is queued on the current stream until the next take(); `upcoming` are the views that will
  /// be taken next. Waits for a photograph that has not been read yet; for an upload the stream waits, not the host.
  /// @throws InputError if this photograph cannot be read; other views can still be taken then.
  TrainView take(std::int32_t index, const std::vector<std::int32_t>& upcoming);

  /// Frees at least so many bytes of a GPU's memory, or all that photographs have there: views stop being resident,
  /// from the last one on. They move to host memory if there is room. What take() gave stays as it is until the next
  /// take(). Returns the bytes that are given back to LibTorch's allocator; 0 on the CPU.
  std::int64_t release_resident(std::int64_t bytes);

 private:
  struct Streamed;
  void load_resident(const std::vector<std::int32_t>& stays, const ProgressFn& progress);
  void start_streaming();
  TrainView take_on_cpu(std::int32_t index, const std::vector<std::int32_t>& streamed);
  TrainView take_on_gpu(std::int32_t index, const std::vector<std::int32_t>& streamed);
  bool is_resident(std::int32_t index) const { return describe(index).truth.defined(); }

  torch::Device device_;
  std::vector<TrainView> views_;
  std::vector<std::shared_ptr<ViewImage>> images_;
  std::vector<std::shared_ptr<const Image8>> held_;  // that tensors of views_ point to, on the CPU
  std::int32_t n_resident_ = 0;
  std::unique_ptr<Streamed> streamed_, retired_;  // the first is null if all views are resident
};

}  // namespace b3dgs
