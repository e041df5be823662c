// The memory of the device that a training runs on: limit, use, allocation and release. An interface, so that tests can
// simulate a lack of memory without a GPU.
#pragma once

#include <torch/types.h>

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <vector>

#include "core/check.h"

namespace b3dgs {

/// Memory use of this process, bytes.
struct MemoryUse {
  std::int64_t in_use = 0;         // by tensors and buffers
  std::int64_t reserved = 0;       // in use or cached by the allocator
  std::int64_t peak_reserved = 0;  // largest `reserved` so far
};

class MemorySource {
 public:
  virtual ~MemorySource() = default;
  /// Bytes that `reserved` can grow to, given what is free now; nothing if memory is not limited.
  virtual std::optional<std::int64_t> limit() = 0;
  virtual MemoryUse use() = 0;
  /// Returns cached memory to the system. Waits for the device.
  virtual void release_unused() = 0;
  /// An uninitialised tensor. @throws OutOfMemoryError
  virtual torch::Tensor allocate(torch::IntArrayRef sizes, const torch::TensorOptions& options) = 0;
};

/// The memory of a device: on a GPU at most `limit_gb` (10^9 bytes; 0 = all that is free), with LibTorch's allocator
/// set to extend its blocks in place. On a CPU memory is neither limited nor measured.
std::shared_ptr<MemorySource> make_memory_source(torch::Device device, double limit_gb);

/// Whether the allocator caches more than 256 MiB and more than a quarter of what is in use.
bool keeps_too_much(const MemoryUse& use);

/// Tries to free memory; returns false if there was nothing to free.
using MemoryRemedy = std::function<bool()>;

/// Calls `work`, and while it runs out of memory, again after each remedy that could free some. `work` must be
/// repeatable. @throws OutOfMemoryError if it still fails after the last remedy
template <class Work>
auto with_remedies(const std::vector<MemoryRemedy>& remedies, Work&& work) -> decltype(work()) {
  auto next = remedies.begin();
  while (true) {
    std::string reason;
    try {
      return work();
    } catch (const OutOfMemoryError& error) {
      reason = error.what();
    } catch (const c10::OutOfMemoryError& error) {
      reason = error.what_without_backtrace();
    }
    while (next != remedies.end() && !(*next)()) ++next;
    if (next == remedies.end()) throw OutOfMemoryError(reason);
    ++next;
  }
}

}  // namespace b3dgs
