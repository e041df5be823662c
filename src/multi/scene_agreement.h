// Whether all ranks read the same scene: each reads the folder of its own machine.
#pragma once

#include <nlohmann/json.hpp>

#include "dist/communicator.h"
#include "scene/scene.h"

namespace b3dgs {

/// All ranks call this together. `fingerprint` has the lists "photographs" and "masks", with a value for each training
/// view that changes with the contents of the file. Ranks exchange a checksum, and what a message needs only if these
/// differ. @throws InputError on all ranks, naming the first rank whose scene differs from that of rank 0 and the first
/// difference: number, names, sizes, lenses, poses, photographs or masks of views, or points
void check_same_scene(Communicator& ranks, const Scene& scene, const nlohmann::ordered_json& fingerprint);

}  // namespace b3dgs
