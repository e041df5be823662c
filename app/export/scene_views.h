// The contribution of each Gaussian to the views of a scene.
#pragma once

#include <vector>

#include "app/common/torch/model.h"

namespace b3dgs {

/// Returns the sum over the pixels of `views` of each Gaussian's blend weight, px. Photographs are not needed.
std::vector<double> blend_weight_sums(const LoadedModel& model, const std::vector<View>& views,
                                      const torch::Device& device, StatusLine& status);

}  // namespace b3dgs
