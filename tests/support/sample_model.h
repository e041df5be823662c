// A small COLMAP model with unusual values that readers must handle.
#pragma once

#include "scene/colmap/colmap.h"

namespace b3dgs::test {

/// Two cameras, unordered images with non-consecutive IDs, and a name with a folder and a blank.
inline ColmapModel sample_model() {
  ColmapModel model;
  model.cameras[7] = {7, CameraModel::kPinhole, 64, 48, {50.25, 51.5, 31, 25}};
  model.cameras[3] = {3, CameraModel::kOpenCv, 640, 480, {500, 501, 320, 240, 0.1, -0.02, 1e-3, -1.0 / 3.0}};
  model.images.push_back({20, {0.5, 0.5, -0.5, 0.5}, {1.0 / 3.0, -2, 3e-9}, 7, "b/second image.png"});
  model.images.push_back({0, {1, 0, 0, 0}, {0, 0, 4}, 3, "a.png"});
  model.points.push_back({0, {0.1, -0.2, 1e3}, {255, 0, 7}, 0.5});
  model.points.push_back({9007199254740993, {1, 2, 3}, {1, 2, 3}, 0});
  return model;
}

}  // namespace b3dgs::test
