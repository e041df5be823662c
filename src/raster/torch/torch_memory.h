// GPU memory: what LibTorch's caching allocator holds in this process, and what is free on the device. Compiled only if
// both nvcc and a LibTorch with CUDA are available.
#pragma once

#include <cstdint>

namespace b3dgs {

/// This process's use of the current device, bytes.
struct TorchMemoryUse {
  std::int64_t in_use = 0;         // tensors and buffers
  std::int64_t reserved = 0;       // in_use and what the allocator caches for reuse
  std::int64_t peak_reserved = 0;  // largest `reserved` so far
  std::int64_t n_requests = 0;     // number of allocations from the device so far
};
TorchMemoryUse torch_memory_use();

/// Memory of the current device, all processes included, bytes.
struct DeviceMemorySize {
  std::int64_t free = 0, total = 0;
};
DeviceMemorySize device_memory_size();

/// Returns the allocator's unused cached memory to the device. Waits for the device.
void release_unused_torch_memory();

/// Limits the memory that the allocator may reserve, bytes; 0 removes the limit.
void limit_torch_memory(std::int64_t bytes);

/// Enables expandable segments: the allocator extends blocks in place instead of allocating one per new size. Does
/// nothing if PYTORCH_CUDA_ALLOC_CONF or PYTORCH_ALLOC_CONF is set. Must be called before the first tensor on the
/// device.
void extend_torch_memory_in_place();

}  // namespace b3dgs
