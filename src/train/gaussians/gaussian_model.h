// Converts between point clouds, SplatCloud (host arrays) and parameter tensors.
#pragma once

#include "model/formats/splat_cloud.h"
#include "raster/torch/gaussian_tensors.h"
#include "scene/points/point_cloud.h"

namespace b3dgs {

inline constexpr double kInitialOpacity = 0.1;

/// One Gaussian per point, as in the original 3DGS: isotropic scale = root mean square distance to the 3 nearest
/// neighbours times `scale`, identity rotation, `opacity`, colour as SH degree 0. shN is zero, for degrees up to
/// `sh_degree`.
SplatCloud splats_from_points(const PointCloud& points, int sh_degree, double opacity = kInitialOpacity,
                              double scale = 1);

/// Float tensors on `device` with SH coefficients up to `sh_degree`: missing ones are zero, higher ones are dropped.
GaussianTensors to_tensors(const SplatCloud& cloud, int sh_degree, torch::Device device);

/// Makes the 3D filter part of scales and opacities, as viewers expect it in a file. `filters` has a value per
/// Gaussian, as GaussianTensors::filters.
void include_filters(const std::vector<float>& filters, SplatCloud& cloud);

/// With filters included, if there are any.
SplatCloud to_splat_cloud(const GaussianTensors& gaussians);

}  // namespace b3dgs
