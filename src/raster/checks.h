// Checks and errors shared by the CPU and the CUDA rasterizer.
#pragma once

#include <cstdint>
#include <limits>
#include <string>

#include "core/check.h"
#include "core/text.h"
#include "raster/args.h"

namespace b3dgs {

/// Largest number of elements that 32-bit indices can address, with one value left for an end. This also limits the
/// (tile, splat) pairs of a view. At 57 bytes each (view_memory.h), more would need over 120 GB of GPU memory.
inline constexpr std::int64_t kIndexMax = std::numeric_limits<std::int32_t>::max() - 1;

inline void check_image_size(const CameraView& view) {
  B3DGS_CHECK(view.width > 0 && view.height > 0, "image size is ", view.width, " x ", view.height,
              ", expected positive");
}

inline void check_render_args(const GaussianArrays& gaussians, const CameraView& view, const RenderSettings& settings) {
  check_image_size(view);
  B3DGS_CHECK(settings.sh_degree >= 0 && settings.sh_degree <= gaussians.sh_degree_max, "SH degree is ",
              settings.sh_degree, ", expected 0 to ", gaussians.sh_degree_max);
  B3DGS_CHECK(gaussians.n_gaussians <= kIndexMax / splats_per_gaussian(view.lens),
              "too many Gaussians for 32-bit indices: ", gaussians.n_gaussians);
  B3DGS_CHECK(settings.near_plane > 0, "near plane is ", settings.near_plane, ", expected above 0");
}

/// Checks the arguments for splats that were projected elsewhere.
inline void check_splat_args(std::int64_t n_splats, const CameraView& view, const RenderSettings& settings) {
  check_image_size(view);
  const std::int64_t n_most = kIndexMax / splats_per_gaussian(view.lens);
  B3DGS_CHECK(n_splats >= 0 && n_splats <= n_most, "number of splats is ", n_splats, ", expected 0 to ", n_most);
  B3DGS_CHECK(!settings.camera_gradient, "the gradient with respect to the camera needs the Gaussians, not splats");
}

/// Thrown if the parameters, projection or colour of a Gaussian are not finite or exceed the limits in constants.h.
/// Training removes that Gaussian and continues.
class InvalidGaussianError : public NumericError {
 public:
  InvalidGaussianError(std::int64_t row, const std::string& message) : NumericError(message), row_(row) {}

  /// Returns the index of the Gaussian in the parameter arrays.
  std::int64_t row() const { return row_; }

 private:
  std::int64_t row_;
};

/// The Gaussian (or row of splats) that touches the most tiles of a view.
struct WidestGaussian {
  std::int64_t index = 0;
  std::int64_t n_tiles = 0;
};

/// Returns the error message for a view with too many pairs. `what` names the thing that `widest` is an index of.
inline std::string too_many_pairs(std::int64_t n_pairs, const WidestGaussian& widest, std::int64_t n_tiles,
                                  const char* what = "Gaussian") {
  return "the view needs " + format_count(n_pairs) + " (tile, Gaussian) pairs, more than " + format_count(kIndexMax) +
         "; " + what + " " + std::to_string(widest.index) + " alone touches " + format_count(widest.n_tiles) + " of " +
         format_count(n_tiles) + " tiles; use smaller images (-r 2) or fewer Gaussians (--max_gaussians)";
}

}  // namespace b3dgs
