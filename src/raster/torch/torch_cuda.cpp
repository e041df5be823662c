#include "raster/torch/torch_cuda.h"

#include <c10/cuda/CUDACachingAllocator.h>
#include <c10/cuda/CUDAFunctions.h>
#include <c10/cuda/CUDAStream.h>

#if __has_include(<c10/core/AllocatorConfig.h>)
#include <c10/core/AllocatorConfig.h>
#define B3DGS_HAS_ALLOCATOR_CONFIG 1
#else
#define B3DGS_HAS_ALLOCATOR_CONFIG 0
#endif

#include <algorithm>
#include <cstdlib>

#include "core/cuda_handles.h"
#include "raster/cuda/device_buffer.h"

namespace b3dgs {

namespace allocator = c10::cuda::CUDACachingAllocator;

MemoryUse torch_memory_use() {
  constexpr std::size_t kAll = 0;  // index of the statistics over all pools
  const auto stats = allocator::getDeviceStats(c10::cuda::current_device());
  const auto& reserved = stats.reserved_bytes[kAll];
  return {stats.allocated_bytes[kAll].current, reserved.current, reserved.peak, stats.segment[kAll].allocated};
}

DeviceMemorySize device_memory_size() {
  std::size_t free = 0, total = 0;
  B3DGS_CUDA_CHECK(cudaMemGetInfo(&free, &total));
  return {static_cast<std::int64_t>(free), static_cast<std::int64_t>(total)};
}

void release_unused_torch_memory() {
  allocator::emptyCache();
}

void limit_torch_memory(std::int64_t bytes) {
  const auto total = static_cast<double>(device_memory_size().total);
  const double share = bytes > 0 ? std::min(1.0, static_cast<double>(bytes) / total) : 1.0;
  allocator::setMemoryFraction(share, c10::cuda::current_device());
}

void extend_torch_memory_in_place() {
  for (const char* name : {"PYTORCH_CUDA_ALLOC_CONF", "PYTORCH_ALLOC_CONF"}) {
    if (std::getenv(name) != nullptr) return;
  }
  constexpr const char* kSetting = "expandable_segments:True";
#if B3DGS_HAS_ALLOCATOR_CONFIG
  c10::CachingAllocator::setAllocatorSettings(kSetting);
#else
  allocator::setAllocatorSettings(kSetting);
#endif
}

namespace {

class TorchMemory final : public cuda::DeviceMemory {
 public:
  void* allocate(std::size_t bytes, cudaStream_t stream) override {
    try {
      return allocator::raw_alloc_with_stream(bytes, stream);
    } catch (const c10::OutOfMemoryError&) {
      throw OutOfMemoryError(detail::concat("not enough GPU memory for ", bytes, " bytes"));
    }
  }
  void free(void* memory, cudaStream_t) noexcept override { allocator::raw_delete(memory); }
};

}  // namespace

struct HostCopy::Memory {
  cuda::PinnedMemory values;
  cuda::Event written;
};

HostCopy::HostCopy(std::size_t bytes)
    : bytes_(bytes), memory_(new Memory{cuda::make_pinned_memory(bytes), cuda::make_event()}) {}

void HostCopy::copy(const void* device) {
  B3DGS_CUDA_CHECK(cudaMemcpyAsync(memory_->values.get(), device, bytes_, cudaMemcpyDeviceToHost, torch_stream()));
  mark();
}

void* HostCopy::memory() {
  return memory_->values.get();
}

void HostCopy::mark() {
  B3DGS_CUDA_CHECK(cudaEventRecord(memory_->written.get(), torch_stream()));
}

const void* HostCopy::wait() const {
  B3DGS_CUDA_CHECK(cudaEventSynchronize(memory_->written.get()));
  return memory_->values.get();
}

cudaStream_t torch_stream() {
  return c10::cuda::getCurrentCUDAStream().stream();
}

cuda::LaunchContext torch_launch_context() {
  static TorchMemory memory;
  return cuda::make_launch_context(torch_stream(), memory);
}

}  // namespace b3dgs
