// CUDA streams, events and memory that are freed with their owner.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <type_traits>

#include "core/cuda_check.h"

namespace b3dgs::cuda {

struct DestroyEvent {
  void operator()(cudaEvent_t event) const { cudaEventDestroy(event); }
};
using Event = std::unique_ptr<std::remove_pointer_t<cudaEvent_t>, DestroyEvent>;

inline Event make_event(unsigned flags = cudaEventDisableTiming) {
  cudaEvent_t event = nullptr;
  B3DGS_CUDA_CHECK(cudaEventCreateWithFlags(&event, flags));
  return Event(event);
}

/// Waits for the work of a stream before destroying it. Declare it last to protect the members that the work uses.
struct FinishStream {
  void operator()(cudaStream_t stream) const {
    cudaStreamSynchronize(stream);
    cudaStreamDestroy(stream);
  }
};
using Stream = std::unique_ptr<std::remove_pointer_t<cudaStream_t>, FinishStream>;

/// Makes a non-blocking stream, which does not synchronise with the default stream, on which LibTorch computes.
inline Stream make_stream() {
  cudaStream_t stream = nullptr;
  B3DGS_CUDA_CHECK(cudaStreamCreateWithFlags(&stream, cudaStreamNonBlocking));
  return Stream(stream);
}

struct FreePinned {
  void operator()(std::uint8_t* memory) const { cudaFreeHost(memory); }
};
using PinnedMemory = std::unique_ptr<std::uint8_t[], FreePinned>;

inline PinnedMemory make_pinned_memory(std::size_t bytes) {
  void* memory = nullptr;
  B3DGS_CUDA_CHECK(cudaMallocHost(&memory, bytes));
  return PinnedMemory(static_cast<std::uint8_t*>(memory));
}

/// Frees memory on the device, which waits for kernels that read it.
struct FreeOnDevice {
  void operator()(std::uint8_t* memory) const { cudaFree(memory); }
};
using MemoryOnDevice = std::unique_ptr<std::uint8_t[], FreeOnDevice>;

inline MemoryOnDevice make_memory_on_device(std::size_t bytes) {
  void* memory = nullptr;
  B3DGS_CUDA_CHECK(cudaMalloc(&memory, bytes));
  return MemoryOnDevice(static_cast<std::uint8_t*>(memory));
}

}  // namespace b3dgs::cuda
