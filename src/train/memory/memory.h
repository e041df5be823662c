// The memory of the device that a training runs on: limit, use, allocation and release, which tests replace to simulate
// a lack of memory without a GPU.
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

/// As on a CPU, where memory is neither limited nor measured.
class MemorySource {
 public:
  virtual ~MemorySource() = default;
  /// Bytes that `reserved` can grow to, given what is free now; nothing if memory is not limited.
  virtual std::optional<std::int64_t> limit() { return std::nullopt; }
  virtual MemoryUse use() { return {}; }
  /// Returns cached memory to the system. Waits for the device.
  virtual void release_unused() {}
  /// An uninitialised tensor. @throws OutOfMemoryError
  virtual torch::Tensor allocate(torch::IntArrayRef sizes, const torch::TensorOptions& options) {
    return allocate_tensor(sizes, options);
  }
};

/// The memory of a device: on a GPU at most `limit_gb` (10^9 bytes; 0 = all that is free), with LibTorch's allocator
/// set to extend its blocks in place.
std::shared_ptr<MemorySource> make_memory_source(torch::Device device, double limit_gb);

/// Whether the allocator caches more than 256 MiB and more than a quarter of what is in use.
bool keeps_too_much(const MemoryUse& use);

/// Tries to free memory; returns false if there was nothing to free.
using MemoryRemedy = std::function<bool()>;

/// For a catch block: frees memory with the first remedy that can, and drops those that were tried.
/// @throws OutOfMemoryError if none is left; the current exception if it is none of memory
void free_memory_or_rethrow(std::vector<MemoryRemedy>& remedies);

/// Calls `work`, and while it runs out of memory, again after each remedy that could free some. `work` must be
/// repeatable. @throws OutOfMemoryError if it still fails after the last remedy
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

// How many Gaussians fit into memory, from the bytes that each one needs. Pure functions.

/// Bytes of all Gaussians' parameters, moments and statistics, including spare capacity.
std::int64_t state_bytes(const TrainState& state);

/// Memory per Gaussian, bytes.
struct GaussianMemory {
  double state = 0;  // parameters, moments and statistics
  double step = 0;   // gradients with respect to projected centres, deferred updates
  double view = 0;   // the rasterizer's buffers for a view, including pairs
  double round = 0;  // a round of density control: its masks and indices, and a copy of the largest tensor
  /// The rasterizer's buffers are freed for a round if both do not fit.
  double all() const { return state + step + std::max(view, round); }
};
/// `n_kept_views`: views of a step whose gradients are kept.
GaussianMemory gaussian_memory(const TrainState& state, const ViewMemory& view, const ViewRatios& ratios,
                               int n_kept_views = 0);

/// The largest number of Gaussians that fits, with a reserve of 1/16 of the limit; at least 1. `limit`:
/// MemorySource::limit(). `other`: bytes in use, independent of the number of Gaussians.
std::int64_t largest_count(std::int64_t limit, std::int64_t other, const GaussianMemory& gaussian);

}  // namespace b3dgs
