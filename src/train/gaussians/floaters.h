// Counts Gaussians that may be floaters: training views say so little about them that they may be wrong in other views.
#pragma once

#include <cstdint>
#include <vector>

#include "raster/torch/rasterizer.h"

namespace b3dgs {

/// A view sees a Gaussian whose blend weight is at least 1/255 in one of its pixels. A Gaussian may be in several of
/// these counts.
struct FloaterCount {
  std::int64_t unseen = 0;    // no view sees them
  std::int64_t one_view = 0;  // one view sees them
  std::int64_t close = 0;     // nearer to a camera that sees them than a tenth of the median depth in its view
  std::int64_t large = 0;     // 3 standard deviations are over 0.3 of the longer side of a view that sees them
};

/// Renders each of the views, and waits for it on a GPU. @throws what Rasterizer::project() throws
FloaterCount count_floaters(Rasterizer& rasterizer, const GaussianTensors& gaussians,
                            const std::vector<PinholeView>& views, const RenderSettings& settings);

}  // namespace b3dgs
