// Counts Gaussians that may be floaters: training views constrain them so little that they may look wrong in others.
#pragma once

#include <cstdint>
#include <vector>

#include "raster/torch/rasterizer.h"

namespace b3dgs {

/// A Gaussian contributes to a view if its blend weight is at least 1/255 in one of the pixels; masks are ignored. One
/// Gaussian can be in several of these counts.
struct FloaterCount {
  std::int64_t unseen = 0;    // contribute to no view
  std::int64_t one_view = 0;  // contribute to exactly one
  std::int64_t close = 0;     // contribute to a view from a distance of less than a tenth of its median depth
  std::int64_t large = 0;     // contribute to a view in which 3 standard deviations exceed 0.3 times its longer side
};

/// Renders every view; on a GPU, waits for each. @throws what Rasterizer::project() and forward_splats() throw
FloaterCount count_floaters(Rasterizer& rasterizer, const GaussianTensors& gaussians,
                            const std::vector<PinholeView>& views, const RenderSettings& settings);

}  // namespace b3dgs
