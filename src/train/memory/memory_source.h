// The memory of the device that a training runs on: how much there is, how much is taken, and what can be given back.
// Handed in, so that a lack of it can be tested without a GPU.
#pragma once

#include <torch/types.h>

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <vector>

#include "core/check.h"

namespace b3dgs {

/// Of this process, bytes.
struct MemoryUse {
  std::int64_t in_use = 0;         // by tensors and buffers
  std::int64_t reserved = 0;       // that, and what is kept to be used again
  std::int64_t peak_reserved = 0;  // largest `reserved` so far
};

class MemorySource {
 public:
  virtual ~MemorySource() = default;
  /// Bytes that `reserved` may become by what is free now; nothing where nobody counts.
  virtual std::optional<std::int64_t> limit() = 0;
  virtual MemoryUse use() = 0;
  /// Gives back what is reserved and not in use. Waits for the device.
  virtual void release_unused() = 0;
  /// A tensor, contents undefined. @throws OutOfMemoryError
  virtual torch::Tensor allocate(torch::IntArrayRef sizes, const torch::TensorOptions& options) = 0;
};

/// The device's own: of a GPU at most `limit_gb` (10^9 bytes; 0: all that is free), with LibTorch's allocator set to
/// extend its blocks in place. A CPU's memory is not counted.
std::shared_ptr<MemorySource> make_memory_source(torch::Device device, double limit_gb);

/// More than a quarter of what is in use, and 256 MB, is kept in vain.
bool keeps_too_much(const MemoryUse& use);

/// What can be done against a lack of memory; false if there is nothing to give.
using MemoryRemedy = std::function<bool()>;

/// Calls `work`, and again after each remedy that had something to give as long as memory is short. So `work` must be
/// such that it can be repeated. @throws OutOfMemoryError when nothing is left
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
