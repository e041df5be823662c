// How a training becomes one of several processes.
#pragma once

#include <cstdint>

#include "config/train_config.h"
#include "dist/communicator.h"
#include "train/train_hooks.h"

namespace b3dgs {

/// The Trainer of these hooks trains together with those of the other ranks, all with the same options and scene.
/// `ranks` must outlive it; with one rank, nothing changes. Ranks that share a GPU get equal parts of what is free
/// there, unless --gpu_memory_gb is given. All ranks call this together. `splats_at_a_time`: see RankStepper.
void train_on_ranks(Communicator& ranks, const TrainConfig& config, TrainHooks& hooks,
                    std::int64_t splats_at_a_time = 2000000);

}  // namespace b3dgs
