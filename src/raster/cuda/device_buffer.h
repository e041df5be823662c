// Device memory: where it comes from, buffers that only grow, and scratch memory that passes share. None is
// initialised. And what the host reads from the device in the middle of a forward pass.
#pragma once

#include <cuda_runtime_api.h>

#include <cstdint>

#include "core/cuda_check.h"

namespace b3dgs::cuda {

/// Allocator of device memory. Blocks are aligned to 256 bytes, and their reuse is ordered on the stream on which they
/// were allocated. Throws OutOfMemoryError.
class DeviceMemory {
 public:
  virtual ~DeviceMemory() = default;
  virtual void* allocate(std::size_t bytes, cudaStream_t stream) = 0;
  virtual void free(void* memory, cudaStream_t stream) noexcept = 0;
};

/// Memory from the CUDA driver, for programs without LibTorch's allocator.
class DriverMemory final : public DeviceMemory {
 public:
  void* allocate(std::size_t bytes, cudaStream_t stream) override {
    void* memory = nullptr;
    B3DGS_CUDA_CHECK(cudaMallocAsync(&memory, bytes, stream));
    return memory;
  }
  void free(void* memory, cudaStream_t stream) noexcept override { cudaFreeAsync(memory, stream); }
};

/// Stream and allocator for the passes. Does not own them.
struct LaunchContext {
  cudaStream_t stream = nullptr;
  DeviceMemory* memory = nullptr;
  int n_multiprocessors = 0;
  // In whose order memory is allocated and freed. If it is another one (SideStream), passes on it neither allocate nor
  // free until join().
  cudaStream_t memory_stream = stream;
};

/// A context on the current device.
inline LaunchContext make_launch_context(cudaStream_t stream, DeviceMemory& memory) {
  LaunchContext context{stream, &memory, 0, stream};
  int device = 0;
  B3DGS_CUDA_CHECK(cudaGetDevice(&device));
  B3DGS_CUDA_CHECK(cudaDeviceGetAttribute(&context.n_multiprocessors, cudaDevAttrMultiProcessorCount, device));
  return context;
}

/// A growing array in device memory. Allocates a quarter more than asked if there is enough memory, so that a slowly
/// growing model does not allocate in every step.
template <class T>
class DeviceBuffer {
 public:
  DeviceBuffer() = default;
  DeviceBuffer(const DeviceBuffer&) = delete;
  DeviceBuffer& operator=(const DeviceBuffer&) = delete;
  ~DeviceBuffer() { release(); }

  /// At least n elements with undefined contents; reallocates if n exceeds the capacity.
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
  /// Frees the memory. Work already queued on the buffer's stream may still use it.
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
    data_ = static_cast<T*>(context.memory->allocate(static_cast<std::size_t>(n) * sizeof(T), context.memory_stream));
    memory_ = context.memory;
    stream_ = context.memory_stream;
    capacity_ = n;
  }

  T* data_ = nullptr;
  std::int64_t capacity_ = 0;
  DeviceMemory* memory_ = nullptr;
  cudaStream_t stream_ = nullptr;
};

/// Assigns arrays within a block of memory, each aligned to 256 bytes. Without a block, only counts the bytes.
class ScratchArrays {
 public:
  explicit ScratchArrays(unsigned char* block = nullptr) : block_(block) {}

  /// n elements with undefined contents; null while counting.
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

/// Scratch memory that passes use in turn: each overwrites what the pass before has left there.
class PassScratch {
 public:
  /// Calls layout(ScratchArrays&) twice: first to count the bytes of the pass's arrays, then to assign them.
  template <class Layout>
  void allocate(const LaunchContext& context, Layout&& layout) {
    ScratchArrays counted;
    layout(counted);
    ScratchArrays assigned(block_.resize(counted.used(), context));
    layout(assigned);
  }
  void release() { block_.release(); }
  std::int64_t bytes() const { return block_.bytes(); }

 private:
  DeviceBuffer<unsigned char> block_;
};

/// A value in pinned host memory, which copies and kernels may write.
template <class T>
class PinnedValue {
 public:
  PinnedValue() { B3DGS_CUDA_CHECK(cudaMallocHost(reinterpret_cast<void**>(&value_), sizeof(T))); }
  ~PinnedValue() { cudaFreeHost(value_); }
  PinnedValue(const PinnedValue&) = delete;
  PinnedValue& operator=(const PinnedValue&) = delete;
  T* get() const { return value_; }

 private:
  T* value_ = nullptr;
};

/// A point in a stream that the host can wait for.
class StreamMark {
 public:
  StreamMark() { B3DGS_CUDA_CHECK(cudaEventCreateWithFlags(&event_, cudaEventDisableTiming)); }
  ~StreamMark() { cudaEventDestroy(event_); }
  StreamMark(const StreamMark&) = delete;
  StreamMark& operator=(const StreamMark&) = delete;
  void record(cudaStream_t stream) { B3DGS_CUDA_CHECK(cudaEventRecord(event_, stream)); }
  void wait() { B3DGS_CUDA_CHECK(cudaEventSynchronize(event_)); }
  bool is_reached() {
    const cudaError_t status = cudaEventQuery(event_);
    if (status == cudaErrorNotReady) {
      cudaGetLastError();  // or the next launch would report it
      return false;
    }
    B3DGS_CUDA_CHECK(status);
    return true;
  }
  /// Lets a stream wait.
  void hold(cudaStream_t stream) { B3DGS_CUDA_CHECK(cudaStreamWaitEvent(stream, event_)); }

 private:
  cudaEvent_t event_ = nullptr;
};

/// A stream for passes beside others; its blocks start first.
class SideStream {
 public:
  SideStream() {
    int least = 0, greatest = 0;
    B3DGS_CUDA_CHECK(cudaDeviceGetStreamPriorityRange(&least, &greatest));
    B3DGS_CUDA_CHECK(cudaStreamCreateWithPriority(&stream_, cudaStreamNonBlocking, greatest));
  }
  ~SideStream() { cudaStreamDestroy(stream_); }
  SideStream(const SideStream&) = delete;
  SideStream& operator=(const SideStream&) = delete;

  /// The context of passes after those that were queued on `main`.
  LaunchContext fork(const LaunchContext& main) {
    forked_.record(main.stream);
    forked_.hold(stream_);
    LaunchContext side = main;
    side.stream = stream_;
    return side;
  }
  /// Passes on `main` from here on come after those of fork().
  void join(const LaunchContext& main) {
    joined_.record(stream_);
    joined_.hold(main.stream);
  }

 private:
  cudaStream_t stream_ = nullptr;
  StreamMark forked_, joined_;
};

}  // namespace b3dgs::cuda
