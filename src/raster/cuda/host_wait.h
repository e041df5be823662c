// What the host reads from the device in the middle of a forward pass, and the point that it waits for.
#pragma once

#include <cuda_runtime_api.h>

#include "core/cuda_check.h"

namespace b3dgs::cuda {

/// A value in pinned host memory, for asynchronous copies from the device.
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

 private:
  cudaEvent_t event_ = nullptr;
};

}  // namespace b3dgs::cuda
