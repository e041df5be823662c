// Copies arrays from the device to the host in pieces while training continues.
#pragma once

#include <cstddef>
#include <functional>
#include <memory>
#include <string_view>
#include <vector>

#include "core/cuda_handles.h"

namespace b3dgs::cuda {

/// Copies of arrays of bytes in device memory, taken after all work queued on a stream so far. Destroying the object
/// returns their memory to the system, not to a caching allocator; no reads may be in progress.
class DeviceSnapshot {
 public:
  /// Queues the copies on `stream`; asynchronous. Null if less than twice their size is free: training may need the
  /// same amount for itself.
  static std::unique_ptr<DeviceSnapshot> make(const std::vector<std::string_view>& arrays, cudaStream_t stream);
  /// The copies, in the order of the arrays.
  const std::vector<std::string_view>& arrays() const { return arrays_; }

 private:
  DeviceSnapshot() = default;

  MemoryOnDevice memory_;
  std::vector<std::string_view> arrays_;
};

/// Copies to the host through two pinned buffers, on a stream of its own. For one thread at a time.
class DeviceReader {
 public:
  static constexpr std::size_t kPieceBytes = std::size_t{4} << 20;

  DeviceReader();

  /// Reads from now on see the result of all work queued on `stream` so far. Asynchronous.
  void follow(cudaStream_t stream);

  /// Calls take(piece, bytes) for one piece after the other, while the next one is being copied.
  void read(const void* device, std::size_t bytes, const std::function<void(const void*, std::size_t)>& take);

 private:
  struct Piece {
    PinnedMemory bytes;
    Event copied;
  };
  Piece pieces_[2];
  Event reached_;
  Stream stream_;  // last: its copies end first
};

}  // namespace b3dgs::cuda
