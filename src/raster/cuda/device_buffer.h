// Device memory: its allocator, buffers that only grow, and scratch memory shared by passes. None of it is initialised.
#pragma once

#include <cuda_runtime_api.h>

#include <cstdint>
#include <memory>

#include "core/cuda_check.h"

namespace b3dgs::cuda {

/// Allocator of device memory. Blocks are aligned to 256 bytes. Their reuse is ordered on the stream on which they were
/// allocated. Throws OutOfMemoryError.
class DeviceMemory {
 public:
  virtual ~DeviceMemory() = default;
  virtual void* allocate(std::size_t bytes, cudaStream_t stream) = 0;
  virtual void free(void* memory, cudaStream_t stream) noexcept = 0;
};

/// Stream and allocator for the passes. Does not own them.
struct LaunchContext {
  cudaStream_t stream = nullptr;
  DeviceMemory* memory = nullptr;
  int n_multiprocessors = 0;
  // Memory is allocated and freed in the order of this stream. If it differs from `stream` (SideStream), passes on
  // `stream` neither allocate nor free until join().
  cudaStream_t memory_stream = stream;
};

/// Makes a context on the current device.
inline LaunchContext make_launch_context(cudaStream_t stream, DeviceMemory& memory) {
  LaunchContext context{stream, &memory, 0, stream};
  int device = 0;
  B3DGS_CUDA_CHECK(cudaGetDevice(&device));
  B3DGS_CUDA_CHECK(cudaDeviceGetAttribute(&context.n_multiprocessors, cudaDevAttrMultiProcessorCount, device));
  return context;
}

/// A growing array in device memory. Allocates a quarter more than requested if there is enough memory, so that a
/// slowly growing model does not allocate in every step.
template <class T>
class DeviceBuffer {
 public:
  DeviceBuffer() = default;
  DeviceBuffer(DeviceBuffer&&) = delete;
  /// Returns n or more elements with undefined contents. Reallocates if n exceeds the capacity.
  T* resize(std::int64_t n, const LaunchContext& context) {
    if (n > capacity_) {
      release();
      try {
        allocate(n + n / 4, context);
      } catch (const OutOfMemoryError&) {
        allocate(n, context);
      }
    }
    return data();
  }
  /// Frees the memory. Work already queued on the buffer's stream may still use it.
  void release() {
    data_.reset();
    capacity_ = 0;
  }
  T* data() const { return data_.get(); }
  std::int64_t bytes() const { return capacity_ * static_cast<std::int64_t>(sizeof(T)); }

 private:
  struct Free {
    DeviceMemory* memory = nullptr;
    cudaStream_t stream = nullptr;
    void operator()(T* data) const { memory->free(data, stream); }
  };
  void allocate(std::int64_t n, const LaunchContext& context) {
    void* const data = context.memory->allocate(static_cast<std::size_t>(n) * sizeof(T), context.memory_stream);
    data_ = {static_cast<T*>(data), Free{context.memory, context.memory_stream}};
    capacity_ = n;
  }

  std::unique_ptr<T, Free> data_;
  std::int64_t capacity_ = 0;
};

/// Assigns arrays within a block of memory, each aligned to 256 bytes. Without a block, it only counts the bytes.
struct ScratchArrays {
  unsigned char* block = nullptr;
  std::int64_t used = 0;

  /// Returns n elements with undefined contents, or null while counting.
  template <class T>
  T* take(std::int64_t n) {
    constexpr std::int64_t kAlignment = 256;
    T* const array = block != nullptr ? reinterpret_cast<T*>(block + used) : nullptr;
    used += (n * static_cast<std::int64_t>(sizeof(T)) + kAlignment - 1) / kAlignment * kAlignment;
    return array;
  }
};

/// Scratch memory that passes use in turn. Each pass overwrites the data of the previous one.
using PassScratch = DeviceBuffer<unsigned char>;

/// Calls layout(ScratchArrays&) twice: first to count the bytes of the pass's arrays, then to assign them.
template <class Layout>
void assign_scratch(PassScratch& scratch, const LaunchContext& context, Layout&& layout) {
  ScratchArrays counted;
  layout(counted);
  ScratchArrays assigned{scratch.resize(counted.used, context)};
  layout(assigned);
}

}  // namespace b3dgs::cuda
