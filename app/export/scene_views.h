// What only the views of a scene can tell about its Gaussians: which way is up, and how much each contributes.
#pragma once

#include <array>
#include <vector>

#include "app/model.h"

namespace b3dgs {

/// Sum over the pixels of `views` of each Gaussian's blend weight, px. Photographs are not needed.
std::vector<double> blend_weight_sums(const LoadedModel& model, const std::vector<View>& views,
                                      const torch::Device& device, StatusLine& status);

/// The direction, in world coordinates, that is up for the cameras: across their horizontal axes, if these differ
/// enough to tell, so that cameras may look up or down; else the mean of their upward axes.
/// @throws InputError if there are no views, or up differs too much among them
std::array<double, 3> up_direction(const std::vector<View>& views);

}  // namespace b3dgs
