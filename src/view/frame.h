// What a browser asks for, and what it gets: a picture of the Gaussians from a camera.
#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "core/check.h"
#include "scene/cameras/camera.h"
#include "scene/images/image.h"

namespace b3dgs {

enum class FrameMode { kRender, kDifference, kDepth, kAlpha, kLoad };

struct FrameRequest {
  Camera camera;
  int view = -1;  // index in ViewedScene::views whose camera this is; -1: none
  FrameMode mode = FrameMode::kRender;
  int quality = 85;                          // of the JPEG, 1 to 100
  std::shared_ptr<const Image8> photograph;  // of the camera's size, for kDifference
};

struct Frame {
  Image8 image;
  int iteration = 0;
  std::int64_t n_gaussians = 0;
  double render_ms = 0;
  std::string legend;  // one line that says what the colours mean; empty for kRender
};

/// The frame cannot be made now; the same request may succeed later.
class BusyError : public Error {
 public:
  using Error::Error;
};

}  // namespace b3dgs
