// Copies arrays from the device to the host in pieces while training continues.
#pragma once

#include <algorithm>
#include <cstddef>
#include <functional>
#include <memory>
#include <string_view>
#include <vector>

#include "core/cuda_handles.h"

namespace b3dgs::cuda {

/// Copies of byte arrays in device memory. The destructor returns their memory to the system, not to a caching
/// allocator. No reads may be in progress then.
struct DeviceSnapshot {
  MemoryOnDevice memory;
  std::vector<std::string_view> arrays;
};

/// Copies the arrays after all work queued on `stream` so far. Asynchronous. Returns null if less than twice their size
/// is free, because training may need the same amount for itself.
inline std::unique_ptr<DeviceSnapshot> make_device_snapshot(const std::vector<std::string_view>& arrays,
                                                            cudaStream_t stream) {
  constexpr std::size_t kAlignment = 256;  // bytes
  const auto aligned = [](std::size_t bytes) { return (bytes + kAlignment - 1) / kAlignment * kAlignment; };
  std::size_t wanted = 0, free = 0, total = 0;
  for (const std::string_view array : arrays) wanted += aligned(array.size());
  B3DGS_CUDA_CHECK(cudaMemGetInfo(&free, &total));
  if (wanted == 0 || free / 2 < wanted) return nullptr;
  auto snapshot = std::make_unique<DeviceSnapshot>();
  try {
    snapshot->memory = make_memory_on_device(wanted);
  } catch (const OutOfMemoryError&) {  // taken by other processes in the meantime
    return nullptr;
  }
  std::uint8_t* to = snapshot->memory.get();
  for (const std::string_view array : arrays) {
    if (!array.empty()) {
      B3DGS_CUDA_CHECK(cudaMemcpyAsync(to, array.data(), array.size(), cudaMemcpyDeviceToDevice, stream));
    }
    snapshot->arrays.emplace_back(reinterpret_cast<const char*>(to), array.size());
    to += aligned(array.size());
  }
  return snapshot;
}

/// Copies to the host through two pinned buffers, on a separate stream. For one thread at a time.
class DeviceReader {
 public:
  static constexpr std::size_t kPieceBytes = std::size_t{4} << 20;

  DeviceReader() : reached_(make_event()), stream_(make_stream()) {
    for (Piece& piece : pieces_) {
      piece = {make_pinned_memory(kPieceBytes), make_event(cudaEventDisableTiming | cudaEventBlockingSync)};
    }
  }

  /// Makes later reads wait for all work queued on `stream` so far. Asynchronous.
  void follow(cudaStream_t stream) {
    B3DGS_CUDA_CHECK(cudaEventRecord(reached_.get(), stream));
    B3DGS_CUDA_CHECK(cudaStreamWaitEvent(stream_.get(), reached_.get(), 0));
  }

  /// Calls take(piece, bytes) for each piece in order, while the next one is being copied.
  void read(const void* device, std::size_t bytes, const std::function<void(const void*, std::size_t)>& take) {
    const std::size_t n_pieces = (bytes + kPieceBytes - 1) / kPieceBytes;
    const auto size_of = [&](std::size_t piece) { return std::min(kPieceBytes, bytes - piece * kPieceBytes); };
    const auto copy = [&](std::size_t piece) {
      B3DGS_CUDA_CHECK(cudaMemcpyAsync(pieces_[piece % 2].bytes.get(),
                                       static_cast<const char*>(device) + piece * kPieceBytes, size_of(piece),
                                       cudaMemcpyDeviceToHost, stream_.get()));
      B3DGS_CUDA_CHECK(cudaEventRecord(pieces_[piece % 2].copied.get(), stream_.get()));
    };
    if (n_pieces > 0) copy(0);
    for (std::size_t piece = 0; piece < n_pieces; ++piece) {
      if (piece + 1 < n_pieces) copy(piece + 1);
      B3DGS_CUDA_CHECK(cudaEventSynchronize(pieces_[piece % 2].copied.get()));
      take(pieces_[piece % 2].bytes.get(), size_of(piece));
    }
  }

 private:
  struct Piece {
    PinnedMemory bytes;
    Event copied;
  };
  Piece pieces_[2];
  Event reached_;
  Stream stream_;  // declared last, so that its copies end before the buffers are freed
};

}  // namespace b3dgs::cuda
