// What every rasterizer asks of its arguments, whatever the device.
#pragma once

#include <limits>

#include "core/check.h"
#include "raster/args.h"

namespace b3dgs {

/// Largest count that 32-bit indices reach, with one value to spare for an end.
inline constexpr std::int64_t kIndexMax = std::numeric_limits<std::int32_t>::max() - 1;

inline void check_render_args(const GaussianArrays& gaussians, const PinholeView& view,
                              const RenderSettings& settings) {
  B3DGS_CHECK(view.width > 0 && view.height > 0, "image is ", view.width, " x ", view.height);
  B3DGS_CHECK(settings.sh_degree >= 0 && settings.sh_degree <= gaussians.sh_degree_max, "SH degree ",
              settings.sh_degree, " of at most ", gaussians.sh_degree_max);
  B3DGS_CHECK(gaussians.n_gaussians <= kIndexMax, "splats carry 32-bit indices; n_gaussians is ",
              gaussians.n_gaussians);
  B3DGS_CHECK(settings.near_plane > 0, "near plane is at ", settings.near_plane, "; depths are sorted as positive");
}

}  // namespace b3dgs
