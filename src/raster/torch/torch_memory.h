// GPU memory of this process: what LibTorch's caching allocator holds, and what is left of the device. Compiled only
// where both nvcc and a LibTorch with CUDA are there.
#pragma once

#include <cstdint>

namespace b3dgs {

/// Bytes of this process on the current device, now.
struct TorchMemoryUse {
  std::int64_t in_use = 0;         // by tensors and buffers
  std::int64_t reserved = 0;       // that, and what the allocator keeps to reuse
  std::int64_t peak_reserved = 0;  // largest `reserved` so far
  std::int64_t n_requests = 0;     // to the device for more, so far
};
TorchMemoryUse torch_memory_use();

/// Bytes of the current device, whoever uses them.
struct DeviceMemorySize {
  std::int64_t free = 0, total = 0;
};
DeviceMemorySize device_memory_size();

/// Gives back to the device what the allocator keeps and nobody uses. Waits for the device.
void release_unused_torch_memory();

/// The allocator holds at most so many bytes from now on; 0: no limit but the device's.
void limit_torch_memory(std::int64_t bytes);

/// Lets the allocator extend its blocks in place instead of taking one for each new size: unless
/// PYTORCH_CUDA_ALLOC_CONF (or PYTORCH_ALLOC_CONF) says what it is to do. Before the first tensor on the device.
void extend_torch_memory_in_place();

}  // namespace b3dgs
