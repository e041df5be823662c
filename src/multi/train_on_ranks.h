// How a training becomes one of several processes.
#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>

#include "config/train_config.h"
#include "dist/communicator.h"
#include "scene/scene.h"
#include "train/train_hooks.h"

namespace b3dgs {

/// The Trainer of these hooks trains together with those of the other ranks, all with the same options and scene.
/// `ranks` must outlive it; with one rank, nothing changes. Ranks that share a GPU get equal parts of what is free
/// there, unless
/// --gpu_memory_gb is given. All ranks call this together. `splats_at_a_time`: see RankStepper.
void train_on_ranks(Communicator& ranks, const TrainConfig& config, TrainHooks& hooks,
                    std::int64_t splats_at_a_time = 2000000);

// Whether all ranks read the same scene: each reads the folder of its own machine.

/// All ranks call this together. `fingerprint` has the lists "photographs" and "masks", with a value for each training
/// view that changes with the contents of the file. Ranks exchange a checksum, and what a message needs only if these
/// differ. @throws InputError on all ranks, naming the first rank whose scene differs from that of rank 0 and the first
/// difference: number, names, sizes, lenses, poses, photographs or masks of views, or points
void check_same_scene(Communicator& ranks, const Scene& scene, const nlohmann::ordered_json& fingerprint);

}  // namespace b3dgs
