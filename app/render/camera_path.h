// Camera paths for rendering.
#pragma once

#include <vector>

#include "scene/cameras/camera.h"

namespace b3dgs {

/// `frames` cameras from the first key camera to the last, through those between at equal steps: centres on a
/// Catmull-Rom curve, rotations along great circles, focal lengths and principal points linear. All frames have the
/// size of the first key. `keys` is not empty.
std::vector<Camera> interpolate_cameras(const std::vector<Camera>& keys, int frames);

}  // namespace b3dgs
