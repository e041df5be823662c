// Device memory that grows and is never filled, and where it comes from.
#pragma once

#include <cuda_runtime_api.h>

#include <cstdint>

#include "core/cuda_check.h"

namespace b3dgs::cuda {

/// Source of device memory. Blocks are aligned to 256 bytes; reuse is ordered on the stream they were asked for on.
/// What does not fit is an OutOfMemoryError.
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

/// Takes a quarter more than asked where there is room for it, so that a slowly growing model stops allocating.
template <class T>
class DeviceBuffer {
 public:
  DeviceBuffer() = default;
  DeviceBuffer(const DeviceBuffer&) = delete;
  DeviceBuffer& operator=(const DeviceBuffer&) = delete;
  ~DeviceBuffer() { release(); }

  /// At least n elements, contents undefined.
  T* resize(std::int64_t n, const LaunchContext& context) {
    if (n > capacity_) {
      release();
      try {
        allocate(n + n / 4, context);
      } catch (const OutOfMemoryError&) {
        allocate(n, context);
      }
    }
    return data_;
  }
  /// Gives the memory back. What is queued on the buffer's stream may still use it.
  void release() {
    if (data_ != nullptr) memory_->free(data_, stream_);
    data_ = nullptr;
    capacity_ = 0;
  }
  T* data() const { return data_; }
  std::int64_t capacity() const { return capacity_; }
  std::int64_t bytes() const { return capacity_ * static_cast<std::int64_t>(sizeof(T)); }

 private:
  void allocate(std::int64_t n, const LaunchContext& context) {
    data_ = static_cast<T*>(context.memory->allocate(static_cast<std::size_t>(n) * sizeof(T), context.stream));
    memory_ = context.memory;
    stream_ = context.stream;
    capacity_ = n;
  }

  T* data_ = nullptr;
  std::int64_t capacity_ = 0;
  DeviceMemory* memory_ = nullptr;
  cudaStream_t stream_ = nullptr;
};

/// Takes arrays out of a block, each aligned to 256 bytes. Without a block it counts what they need.
class ScratchArrays {
 public:
  explicit ScratchArrays(unsigned char* block = nullptr) : block_(block) {}

  /// n elements, contents undefined; null while counting.
  template <class T>
  T* take(std::int64_t n) {
    constexpr std::int64_t kAlignment = 256;
    T* const array = block_ != nullptr ? reinterpret_cast<T*>(block_ + used_) : nullptr;
    used_ += (n * static_cast<std::int64_t>(sizeof(T)) + kAlignment - 1) / kAlignment * kAlignment;
    return array;
  }
  std::int64_t used() const { return used_; }

 private:
  unsigned char* block_;
  std::int64_t used_ = 0;
};

/// Memory that passes work in one after the other: each overwrites what the one before has left there.
class PassScratch {
 public:
  /// `layout` takes the pass's arrays from a ScratchArrays; it is called once to count and once to get them.
  template <class Layout>
  void lend(const LaunchContext& context, Layout&& layout) {
    ScratchArrays counted;
    layout(counted);
    ScratchArrays lent(block_.resize(counted.used(), context));
    layout(lent);
  }
  void release() { block_.release(); }
  std::int64_t bytes() const { return block_.bytes(); }

 private:
  DeviceBuffer<unsigned char> block_;
};

}  // namespace b3dgs::cuda
