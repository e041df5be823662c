// Device memory that grows and is never filled, and where it comes from.
#pragma once

#include <cuda_runtime_api.h>

#include <cstdint>

#include "raster/cuda/cuda_check.h"

namespace b3dgs::cuda {

/// Source of device memory. Blocks are aligned to 256 bytes; reuse is ordered on the stream they were asked for on.
class DeviceMemory {
 public:
  virtual ~DeviceMemory() = default;
  virtual void* allocate(std::size_t bytes, cudaStream_t stream) = 0;
  virtual void free(void* memory, cudaStream_t stream) noexcept = 0;
};

/// Straight from the driver; for programs without LibTorch's allocator.
class DriverMemory final : public DeviceMemory {
 public:
  void* allocate(std::size_t bytes, cudaStream_t stream) override {
    void* memory = nullptr;
    B3DGS_CUDA_CHECK(cudaMallocAsync(&memory, bytes, stream));
    return memory;
  }
  void free(void* memory, cudaStream_t stream) noexcept override { cudaFreeAsync(memory, stream); }
};

/// What every pass runs on: borrowed, never owned.
struct LaunchContext {
  cudaStream_t stream = nullptr;
  DeviceMemory* memory = nullptr;
  int n_multiprocessors = 0;
};

/// A context on the current device.
inline LaunchContext make_launch_context(cudaStream_t stream, DeviceMemory& memory) {
  LaunchContext context{stream, &memory, 0};
  int device = 0;
  B3DGS_CUDA_CHECK(cudaGetDevice(&device));
  B3DGS_CUDA_CHECK(cudaDeviceGetAttribute(&context.n_multiprocessors, cudaDevAttrMultiProcessorCount, device));
  return context;
}

/// Grows by a quarter more than asked, so that a slowly growing model stops allocating.
template <class T>
class DeviceBuffer {
 public:
  DeviceBuffer() = default;
  DeviceBuffer(const DeviceBuffer&) = delete;
  DeviceBuffer& operator=(const DeviceBuffer&) = delete;
  ~DeviceBuffer() {
    if (data_ != nullptr) memory_->free(data_, stream_);
  }

  /// At least n elements, contents undefined.
  T* resize(std::int64_t n, const LaunchContext& context) {
    if (n > capacity_) {
      const std::int64_t grown = n + n / 4;
      if (data_ != nullptr) memory_->free(data_, context.stream);
      data_ = nullptr;
      capacity_ = 0;
      data_ = static_cast<T*>(context.memory->allocate(static_cast<std::size_t>(grown) * sizeof(T), context.stream));
      memory_ = context.memory;
      stream_ = context.stream;
      capacity_ = grown;
    }
    return data_;
  }
  T* data() const { return data_; }
  std::int64_t capacity() const { return capacity_; }

 private:
  T* data_ = nullptr;
  std::int64_t capacity_ = 0;
  DeviceMemory* memory_ = nullptr;
  cudaStream_t stream_ = nullptr;
};

}  // namespace b3dgs::cuda
