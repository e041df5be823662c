// Memory of the device that a training runs on: limit, use, allocation and release. Tests replace these to simulate a
// lack of memory without a GPU.
#pragma once

#include <torch/types.h>

#include <algorithm>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <vector>

#include "config/view_ratios.h"
#include "raster/torch/torch_cuda.h"
#include "raster/view_memory.h"
#include "train/checkpoint/train_state.h"

namespace b3dgs {

/// Memory of a CPU, which is neither limited nor measured. Base class of other devices.
class MemorySource {
 public:
  virtual ~MemorySource() = default;
  /// Returns the number of bytes that MemoryUse::reserved can grow to, given the memory that is free now, or nothing if
  /// memory is not limited.
  virtual std::optional<std::int64_t> limit() { return std::nullopt; }
  virtual MemoryUse use() { return {}; }
  /// Returns cached memory to the system. Waits for the device.
  virtual void release_unused() {}
  /// Returns an uninitialised tensor. @throws OutOfMemoryError
  virtual torch::Tensor allocate(torch::IntArrayRef sizes, const torch::TensorOptions& options) {
    return allocate_tensor(sizes, options);
  }
};

/// Returns the memory of a device. On a GPU it is limited to `limit_gb` (10^9 bytes; 0 = all free memory), and
/// LibTorch's allocator is set to extend its blocks in place.
std::shared_ptr<MemorySource> make_memory_source(torch::Device device, double limit_gb);

/// Returns whether the allocator caches more than 256 MiB and more than a quarter of the memory in use.
bool keeps_too_much(const MemoryUse& use);

/// Tries to free memory. Returns false if there was nothing to free.
using MemoryRemedy = std::function<bool()>;

/// Call this in a catch block. Frees memory with the first remedy that can, and removes the remedies that were tried
/// from the list.
/// @throws OutOfMemoryError if no remedy is left; the current exception if it is not about memory
void free_memory_or_rethrow(std::vector<MemoryRemedy>& remedies);

/// Calls work(). If it runs out of memory, calls it again after each remedy that freed some, so it must be repeatable.
/// @throws OutOfMemoryError if it still fails after the last remedy
template <class Work>
auto with_remedies(std::vector<MemoryRemedy> remedies, Work&& work) -> decltype(work()) {
  for (;;) {
    try {
      return work();
    } catch (...) {
      free_memory_or_rethrow(remedies);
    }
  }
}

// Estimates of how many Gaussians fit into memory, from the bytes per Gaussian. Pure functions.

/// Returns the bytes of all Gaussians' parameters, moments and statistics, including spare capacity.
std::int64_t state_bytes(const TrainState& state);

/// Memory per Gaussian in bytes.
struct GaussianMemory {
  double state = 0;  // parameters, moments and statistics
  double step = 0;   // gradients with respect to projected centres, deferred updates
  double view = 0;   // the rasterizer's buffers for a view, including pairs
  double round = 0;  // a round of density control: masks, indices, and a copy of the largest tensor
  /// Returns the total. A round and the rasterizer's buffers do not add up, because these are freed for a round if both
  /// do not fit.
  double all() const { return state + step + std::max(view, round); }
};
/// Returns the estimate. `n_kept_views` is the number of views in a step whose gradients are kept.
GaussianMemory gaussian_memory(const TrainState& state, const ViewMemory& view, const ViewRatios& ratios,
                               int n_kept_views = 0);

/// Returns the largest number of Gaussians that fits, with a reserve of 1/16 of the limit, and at least 1. `limit` is
/// MemorySource::limit(). `other` is the memory in use that does not depend on the number of Gaussians, in bytes.
std::int64_t largest_count(std::int64_t limit, std::int64_t other, const GaussianMemory& gaussian);

}  // namespace b3dgs
