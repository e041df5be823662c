// Argument checks that the CPU and the CUDA rasterizer share.
#pragma once

#include <limits>

#include "core/check.h"
#include "raster/args.h"

namespace b3dgs {

/// Largest number of elements that 32-bit indices can address, leaving one value for an end.
inline constexpr std::int64_t kIndexMax = std::numeric_limits<std::int32_t>::max() - 1;

inline void check_image_size(const PinholeView& view) {
  B3DGS_CHECK(view.width > 0 && view.height > 0, "image size is ", view.width, " x ", view.height,
              ", expected positive");
}

inline void check_render_args(const GaussianArrays& gaussians, const PinholeView& view,
                              const RenderSettings& settings) {
  check_image_size(view);
  B3DGS_CHECK(settings.sh_degree >= 0 && settings.sh_degree <= gaussians.sh_degree_max, "SH degree is ",
              settings.sh_degree, ", expected 0 to ", gaussians.sh_degree_max);
  B3DGS_CHECK(gaussians.n_gaussians <= kIndexMax, "too many Gaussians for 32-bit indices: ", gaussians.n_gaussians);
  B3DGS_CHECK(settings.near_plane > 0, "near plane is ", settings.near_plane, ", expected above 0");
}

/// For splats whose Gaussians are elsewhere.
inline void check_splat_args(std::int64_t n_splats, const PinholeView& view, const RenderSettings& settings) {
  check_image_size(view);
  B3DGS_CHECK(n_splats >= 0 && n_splats <= kIndexMax, "number of splats is ", n_splats, ", expected 0 to ", kIndexMax);
  B3DGS_CHECK(!settings.camera_gradient, "the gradient with respect to the camera needs the Gaussians, not splats");
}

}  // namespace b3dgs
