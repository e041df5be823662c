// For tests of cameras that can be read but not used, whichever models these are.
#pragma once

#include <algorithm>
#include <optional>

#include "scene/colmap/colmap.h"

namespace b3dgs::test {

/// Nothing if every model that can be read is supported.
inline std::optional<ColmapCamera> unsupported_camera(std::uint32_t id, std::uint64_t width, std::uint64_t height) {
  const std::vector<CameraModel> supported = supported_camera_models();
  for (int model_id = 0; model_id <= static_cast<int>(CameraModel::kThinPrismFisheye); ++model_id) {
    const auto model = static_cast<CameraModel>(model_id);
    if (std::find(supported.begin(), supported.end(), model) != supported.end()) continue;
    std::vector<double> params{50, 50, 20, 15};
    params.resize(static_cast<std::size_t>(camera_model_param_count(model)));
    return ColmapCamera{id, model, width, height, params};
  }
  return std::nullopt;
}

}  // namespace b3dgs::test
