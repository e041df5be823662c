// What the views of a scene show of each Gaussian.
#pragma once

#include <string>
#include <vector>

#include "app/common/torch/model.h"

namespace b3dgs {

/// Returns the sum over the pixels of `views` of each Gaussian's blend weight, px. Photographs are not needed.
std::vector<double> blend_weight_sums(const LoadedModel& model, const std::vector<View>& views,
                                      const torch::Device& device, StatusLine& status);

/// @throws InputError if `kinds`, the value of --floater_kinds, is neither "all" nor a list of kinds
void check_floater_kinds(const std::string& kinds);

/// The Gaussians that the training's summary counts as possible floaters (find_floaters() in train/gaussians).
struct PossibleFloaters {
  std::vector<bool> is_one;  // for each Gaussian
  std::string counts;        // "12 unseen, 3 close; kept: 40 one_view, 5 large"; some are of several kinds
};

/// Returns the floaters of these kinds in the training views. @throws InputError if there are no views
PossibleFloaters possible_floaters(const LoadedModel& model, const std::string& kinds, const torch::Device& device,
                                   StatusLine& status);

}  // namespace b3dgs
