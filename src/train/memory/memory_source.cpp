#include "train/memory/memory_source.h"

#include <algorithm>

#include "train/density/row_edit.h"

#if B3DGS_TORCH_CUDA
#include "raster/torch/torch_memory.h"
#endif

namespace b3dgs {
namespace {

class UncountedMemory final : public MemorySource {
 public:
  std::optional<std::int64_t> limit() override { return std::nullopt; }
  MemoryUse use() override { return {}; }
  void release_unused() override {}
  torch::Tensor allocate(torch::IntArrayRef sizes, const torch::TensorOptions& options) override {
    return allocate_tensor(sizes, options);
  }
};

#if B3DGS_TORCH_CUDA
class GpuMemory final : public MemorySource {
 public:
  explicit GpuMemory(double limit_gb) : limit_bytes_(static_cast<std::int64_t>(std::min(1e9 * limit_gb, 9e18))) {
    extend_torch_memory_in_place();
    allocate_tensor({1},
                    torch::TensorOptions(torch::kCUDA));  // the allocator must be initialised before a limit can be set
    limit_torch_memory(limit_bytes_);
  }
  std::optional<std::int64_t> limit() override {
    // The driver needs some memory itself, for kernels that are loaded later and for events.
    constexpr std::int64_t kForTheDriver = 64 << 20;
    const std::int64_t reached = torch_memory_use().reserved + device_memory_size().free;
    const std::int64_t all = std::max<std::int64_t>(0, reached - kForTheDriver);
    return limit_bytes_ > 0 ? std::min(all, limit_bytes_) : all;
  }
  MemoryUse use() override {
    const TorchMemoryUse now = torch_memory_use();
    return {now.in_use, now.reserved, now.peak_reserved};
  }
  void release_unused() override { release_unused_torch_memory(); }
  torch::Tensor allocate(torch::IntArrayRef sizes, const torch::TensorOptions& options) override {
    return allocate_tensor(sizes, options);
  }

 private:
  std::int64_t limit_bytes_;
};
#endif

}  // namespace

std::shared_ptr<MemorySource> make_memory_source([[maybe_unused]] torch::Device device,
                                                 [[maybe_unused]] double limit_gb) {
#if B3DGS_TORCH_CUDA
  if (device.is_cuda()) return std::make_shared<GpuMemory>(limit_gb);
#endif
  return std::make_shared<UncountedMemory>();
}

bool keeps_too_much(const MemoryUse& use) {
  constexpr std::int64_t kAlways = 256 << 20;
  return use.reserved - use.in_use > std::max(kAlways, use.in_use / 4);
}

}  // namespace b3dgs
