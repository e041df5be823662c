// What an export has cost: renders of the exported file against the photographs, and against the model's renders.
#pragma once

#include "app/model.h"

namespace b3dgs {

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
