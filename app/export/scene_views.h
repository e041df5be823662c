// What only the views of a scene can tell about its Gaussians: which way is up, how much each contributes, and what an
// export has cost.
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

/// What an export has cost.
struct ExportQuality {
  std::size_t n_views = 0;
  double psnr_before = 0, psnr_after = 0;  // dB, against the photographs, mean over the views
  double psnr_between = 0;                 // dB, of the renders after against those before
};

/// Renders `model` and `exported`, which have the same world frame, from `views`, which have photographs.
/// Stops early after a signal (stop_signal()).
ExportQuality compare_export(const LoadedModel& model, SplatCloud exported, const std::vector<View>& views,
                             const torch::Device& device, StatusLine& status);

}  // namespace b3dgs
