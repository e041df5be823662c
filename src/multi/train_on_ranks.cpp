#include "multi/train_on_ranks.h"

#include <cstdint>

#include "multi/rank_stepper.h"
#include "raster/torch/torch_cuda.h"

namespace b3dgs {

void train_on_ranks(Communicator& ranks, const TrainConfig& config, TrainHooks& hooks, std::int64_t splats_at_a_time) {
  if (ranks.size() == 1) return;
  hooks.make_stepper = [&ranks, splats_at_a_time](Training& training) {
    return std::make_unique<RankStepper>(training, ranks, splats_at_a_time);
  };
  if (kTorchHasCuda && config.gpu_memory_gb == 0 && ranks.shares_gpus()) {
    device_memory_size();  // makes the context of this process, which takes memory itself
    ranks.barrier("start of the GPU");
    const std::int64_t free = device_memory_size().free;
    ranks.barrier("free GPU memory");
    hooks.gpu_memory_gb = 1e-9 * static_cast<double>(free) / ranks.n_on_own_gpu();
  }
}

}  // namespace b3dgs
