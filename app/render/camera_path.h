// Camera paths for `b3dgs render`.
#pragma once

#include <vector>

#include "scene/cameras/camera.h"

namespace b3dgs {

/// `frames` cameras on a path through all key cameras, with the same number of frames between any two of them. Centres
/// follow a Catmull-Rom spline, rotations are interpolated by slerp, focal lengths and principal points linearly. All
/// frames have the image size of the first key. `keys` must not be empty.
std::vector<Camera> interpolate_cameras(const std::vector<Camera>& keys, int frames);

}  // namespace b3dgs
