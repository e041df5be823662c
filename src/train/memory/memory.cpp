#include "train/memory/memory.h"

#include "core/check.h"
#include "train/density/row_edit.h"

namespace b3dgs {
namespace {

class GpuMemory final : public MemorySource {
 public:
  explicit GpuMemory(double limit_gb) : limit_bytes_(static_cast<std::int64_t>(std::min(1e9 * limit_gb, 9e18))) {
    extend_torch_memory_in_place();
    allocate_tensor({1}, torch::kCUDA);  // initialises the allocator, before which no limit can be set
    limit_torch_memory(limit_bytes_);
  }
  std::optional<std::int64_t> limit() override {
    // The driver itself needs some memory, for kernels that are loaded later and for events.
    constexpr std::int64_t kForTheDriver = 64 << 20;
    const std::int64_t reached = torch_memory_use().reserved + device_memory_size().free;
    const std::int64_t all = std::max<std::int64_t>(0, reached - kForTheDriver);
    return limit_bytes_ > 0 ? std::min(all, limit_bytes_) : all;
  }
  MemoryUse use() override { return torch_memory_use(); }
  void release_unused() override { release_unused_torch_memory(); }

 private:
  std::int64_t limit_bytes_;
};

}  // namespace

std::shared_ptr<MemorySource> make_memory_source(torch::Device device, double limit_gb) {
  if constexpr (kTorchHasCuda) {
    if (device.is_cuda()) return std::make_shared<GpuMemory>(limit_gb);
  }
  return std::make_shared<MemorySource>();
}

void free_memory_or_rethrow(std::vector<MemoryRemedy>& remedies) {
  std::string reason;
  try {
    throw;
  } catch (const OutOfMemoryError& error) {
    reason = error.what();
  } catch (const c10::OutOfMemoryError& error) {
    reason = error.what_without_backtrace();
  }
  while (!remedies.empty()) {
    const MemoryRemedy next = std::move(remedies.front());
    remedies.erase(remedies.begin());
    if (next()) return;
  }
  throw OutOfMemoryError(reason);
}

bool keeps_too_much(const MemoryUse& use) {
  constexpr std::int64_t kAlways = 256 << 20;
  return use.reserved - use.in_use > std::max(kAlways, use.in_use / 4);
}

std::int64_t state_bytes(const TrainState& state) {
  std::int64_t bytes = 0;
  visit_rows(state.gaussians, state.adam, state.statistics,
             [&](const torch::Tensor& tensor) { bytes += static_cast<std::int64_t>(tensor.storage().nbytes()); });
  return bytes;
}

GaussianMemory gaussian_memory(const TrainState& state, const ViewMemory& view, const ViewRatios& ratios,
                               int n_kept_views) {
  // 8 bytes for the gradient with respect to the projected centre, 32 for a DeferredUpdate (optimizer/deferred_sh.h).
  constexpr double kStep = 8 + 32;
  // Masks, thresholds and indices of a round, before the row edit allocates.
  constexpr double kPlan = 64;
  const auto row_bytes = [](const torch::Tensor& tensor) {
    return static_cast<double>(static_cast<std::int64_t>(tensor.itemsize()) * row_elements(tensor));
  };
  GaussianMemory memory;
  double largest = 0;
  visit_rows(state.gaussians, state.adam, state.statistics, [&](const torch::Tensor& tensor) {
    memory.state += row_bytes(tensor);
    largest = std::max(largest, row_bytes(tensor));
  });
  memory.step = kStep;
  if (n_kept_views > 0) {
    // For each view the kept splats and their indices (raster/args.h), and a copy of the statistics, all with a quarter
    // to spare.
    constexpr double kSpare = 1.25, kIndex = 4, kRecord = 48;
    memory.step += kSpare * n_kept_views * (kIndex + kRecord * ratios.splats());
    for (const torch::Tensor* column : state.statistics.all()) memory.step += kSpare * row_bytes(*column);
  }
  // Gaussians grow and become more opaque between two rounds and after the last one, so the number of pairs increases
  // although the number of Gaussians does not.
  constexpr double kPairGrowth = 1.25;
  memory.view = view.bytes(1, kPairGrowth * ratios.pairs());
  memory.round = kPlan + largest;
  return memory;
}

std::int64_t largest_count(std::int64_t limit, std::int64_t other, const GaussianMemory& gaussian) {
  constexpr double kUsable = 1 - 1.0 / 16;
  const double left = kUsable * static_cast<double>(limit) - static_cast<double>(other);
  return static_cast<std::int64_t>(std::clamp(left / gaussian.all(), 1.0, 9e18));
}

}  // namespace b3dgs
