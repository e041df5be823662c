// LibTorch on a GPU: its stream, its caching allocator, and the allocator's memory in this process. Every build can
// include this header, but the functions exist only if both nvcc and a LibTorch with CUDA are available. Call them
// where kTorchHasCuda is true.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>

#include "core/gpu_rows.h"
#include "core/parallel.h"
#include "core/vec.h"

namespace b3dgs {

namespace cuda {
struct LaunchContext;
}

/// The compiler drops code that depends on this, and with it calls of functions that this build does not have.
inline constexpr bool kTorchHasCuda = B3DGS_TORCH_CUDA;

/// Use of the current device by this process, bytes.
struct MemoryUse {
  std::int64_t in_use = 0;         // live allocations, without the allocator's cache
  std::int64_t reserved = 0;       // in_use and what the allocator caches for reuse
  std::int64_t peak_reserved = 0;  // largest `reserved` so far
  std::int64_t n_requests = 0;     // number of allocations from the device so far
};
MemoryUse torch_memory_use();

/// Memory of the current device, including all processes, bytes.
struct DeviceMemorySize {
  std::int64_t free = 0, total = 0;
};
DeviceMemorySize device_memory_size();

/// Returns the allocator's unused cached memory to the device. Waits for the device.
void release_unused_torch_memory();

/// Limits the memory that the allocator may reserve, bytes; 0 removes the limit.
void limit_torch_memory(std::int64_t bytes);

/// Enables expandable segments, with which the allocator extends blocks in place instead of allocating one per new
/// size. Does nothing if PYTORCH_CUDA_ALLOC_CONF or PYTORCH_ALLOC_CONF is set. Must be called before the first tensor
/// on the device.
void extend_torch_memory_in_place();

/// LibTorch's current stream.
cudaStream_t torch_stream();

/// Calls row(args, i) for each i in [0, n): on the GPU, asynchronously in LibTorch's current stream, or on CPU threads.
template <auto row, class Args>
void for_rows(bool on_gpu, const Args& args, std::int64_t n) {
  if constexpr (kTorchHasCuda) {
    if (on_gpu) return cuda::for_rows<row>(args, n, torch_stream());
  }
  for_rows<row>(args, n);
}

/// Makes a context on the current device and LibTorch's current stream. Memory comes from LibTorch's caching allocator,
/// which throws OutOfMemoryError. The allocator object lives until the program ends.
cuda::LaunchContext torch_launch_context();

/// Reads GPU results without stalling the GPU. Values go to pinned memory, and the host reads them while a later step
/// is running.
class HostCopy {
 public:
  explicit HostCopy(std::size_t bytes);
  /// Queues the copy of the values in device memory. Asynchronous.
  void copy(const void* device);
  /// Returns the memory for a kernel that writes the values itself, before mark(). Faster than copy().
  void* memory();
  /// Call when everything that writes the values is queued.
  void mark();
  /// Waits for the last copy() or mark() and returns its values.
  const void* wait() const;

 private:
  struct Memory;
  std::size_t bytes_;
  std::shared_ptr<Memory> memory_;  // pinned
};

}  // namespace b3dgs
