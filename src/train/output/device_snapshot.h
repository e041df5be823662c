// Arrays on the device, brought to the host in pieces beside the training.
#pragma once

#include <cuda_runtime_api.h>

#include <cstddef>
#include <functional>
#include <memory>
#include <vector>

namespace b3dgs::cuda {

struct DeviceBytes {
  const void* data = nullptr;
  std::size_t bytes = 0;
};

/// Copies of arrays as they are when all that was queued on a stream before is done. Their memory goes back to the
/// system with the object, not to an allocator that would keep it.
class DeviceSnapshot {
 public:
  /// Queues the copies on `stream` and does not wait. Null if the device does not have twice their memory free: the
  /// training may need as much for itself.
  static std::unique_ptr<DeviceSnapshot> make(const std::vector<DeviceBytes>& arrays, cudaStream_t stream);
  /// Nothing may be reading it any more.
  ~DeviceSnapshot();
  DeviceSnapshot(const DeviceSnapshot&) = delete;
  DeviceSnapshot& operator=(const DeviceSnapshot&) = delete;

  /// The copies, in the order of the arrays.
  const std::vector<DeviceBytes>& arrays() const { return arrays_; }

 private:
  DeviceSnapshot() = default;

  void* memory_ = nullptr;
  std::vector<DeviceBytes> arrays_;
};

/// Copies to the host through two pieces of pinned memory, on a stream of its own. For one thread at a time.
class DeviceReader {
 public:
  static constexpr std::size_t kPieceBytes = std::size_t{4} << 20;

  DeviceReader();
  ~DeviceReader();
  DeviceReader(const DeviceReader&) = delete;
  DeviceReader& operator=(const DeviceReader&) = delete;

  /// What is read from now on is as it is once all that `stream` has been given is done. Does not wait.
  void follow(cudaStream_t stream);

  /// Calls take(piece, bytes) for one piece after the other, the next one being copied meanwhile.
  void read(const void* device, std::size_t bytes, const std::function<void(const void*, std::size_t)>& take);

 private:
  void free_all() noexcept;

  cudaStream_t stream_ = nullptr;
  cudaEvent_t reached_ = nullptr;
  cudaEvent_t copied_[2] = {nullptr, nullptr};
  void* pieces_[2] = {nullptr, nullptr};  // pinned
};

}  // namespace b3dgs::cuda
