// Inside the reader of transforms.json: the camera of a frame.
#pragma once

#include <functional>
#include <optional>

#include "scene/colmap/colmap.h"
#include "scene/images/image.h"
#include "scene/transforms/json_values.h"

namespace b3dgs::transforms {

/// The camera of a frame, with ID 0, in the simplest of COLMAP's models that has its distortion. `size_of_photograph`
/// is asked if there is no w or h; without a size, the result is nothing. @throws InputError for camera models that
/// photographs cannot be undistorted from, and missing or impossible values
std::optional<ColmapCamera> camera_of_frame(const FrameValues& values,
                                            const std::function<std::optional<ImageSize>()>& size_of_photograph);

}  // namespace b3dgs::transforms
