// The views of a scene on the device that trains: photographs stay 8-bit.
#pragma once

#include <torch/types.h>

#include <string>
#include <vector>

#include "raster/args.h"
#include "scene/scene.h"

namespace b3dgs {

struct TrainView {
  std::string name;
  PinholeView camera{};
  torch::Tensor truth;       // [H, W, 3] uint8
  torch::Tensor valid;       // [H, W] uint8, 0 where the photograph does not count; undefined: all of it counts
  std::int64_t n_valid = 0;  // px
};

/// On the CPU the tensors are views of the scene's own images, which must outlive them.
std::vector<TrainView> upload_views(const std::vector<View>& views, torch::Device device);

}  // namespace b3dgs
