// Adds points found in the photographs where the scene lacks them.
#pragma once

#include <cstdint>

#include "scene/scene.h"

namespace b3dgs {

/// Adds points that seed_points() finds in at most 120 training photographs, in the frame of the scene: about 50,000
/// (two for each pixel of smaller photographs) if the scene has none; if it has some, and more than a tenth of the
/// image area shows none of them, at most that fraction of this number there, only at pixels of clear depth. Returns
/// how many. The scene's frame must be that of choose_frame() for its cameras and points.
std::int64_t add_points_of_photographs(Scene& scene, const ProgressFn& progress);

}  // namespace b3dgs
