// The photographs of the training views, 8-bit, where a step can read them without waiting. Within a budget of bytes
// they stay on the device; the others lie in pinned memory of the host, and are uploaded on a stream of their own while
// earlier steps are under way. Every view is taken once in each pass over the scene, so which ones stay makes no
// difference: the first ones do.
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

class ImageStore {
 public:
  static constexpr std::size_t kLookAhead = 2;  // views that are uploaded while another is in use

  /// On the CPU tensors are views of the scene's own images, which must outlive them, and the budget does not matter.
  /// On a GPU kLookAhead + 1 photographs lie there beyond the budget, if it is too small for all.
  ImageStore(const std::vector<View>& views, torch::Device device, std::int64_t budget_bytes);
  ~ImageStore();
  ImageStore(const ImageStore&) = delete;
  ImageStore& operator=(const ImageStore&) = delete;

  std::int32_t size() const { return static_cast<std::int32_t>(views_.size()); }
  std::int32_t n_resident() const { return n_resident_; }

  /// Name, camera and n_valid; the tensors are those of take() where the view is resident, else undefined.
  const TrainView& describe(std::int32_t index) const { return views_[static_cast<std::size_t>(index)]; }

  /// The view for work that is queued on the current stream until the next take(); `upcoming` (the first kLookAhead of
  /// them) are the views that will be taken next. The host does not wait; the stream does if an upload is not done.
  TrainView take(std::int32_t index, const std::vector<std::int32_t>& upcoming);

  /// Frees at least so many bytes of a GPU's memory, or all that photographs have there: views stop being resident,
  /// from the last one on. Returns the bytes that are given back to LibTorch's allocator; 0 on the CPU.
  std::int64_t release_resident(std::int64_t bytes);

 private:
  struct Streamed;
  torch::Device device_;
  std::vector<TrainView> views_;
  std::int32_t n_resident_ = 0;
  std::unique_ptr<Streamed> streamed_;  // null if all views are resident
};

}  // namespace b3dgs
