#include "raster/torch/torch_launch.h"

#include <c10/cuda/CUDACachingAllocator.h>
#include <c10/cuda/CUDAStream.h>

namespace b3dgs {
namespace {

class TorchMemory final : public cuda::DeviceMemory {
 public:
  void* allocate(std::size_t bytes, cudaStream_t stream) override {
    try {
      return c10::cuda::CUDACachingAllocator::raw_alloc_with_stream(bytes, stream);
    } catch (const c10::OutOfMemoryError&) {
      throw OutOfMemoryError(detail::concat("not enough GPU memory for ", bytes, " bytes"));
    }
  }
  void free(void* memory, cudaStream_t) noexcept override { c10::cuda::CUDACachingAllocator::raw_delete(memory); }
};

}  // namespace

cuda::LaunchContext torch_launch_context() {
  static TorchMemory memory;
  return cuda::make_launch_context(c10::cuda::getCurrentCUDAStream().stream(), memory);
}

}  // namespace b3dgs
