// Parameters of a model as tensors: from points or files, and back.
#pragma once

#include "model/formats/splat_cloud.h"
#include "raster/torch/gaussian_tensors.h"
#include "scene/point_cloud.h"

namespace b3dgs {

inline constexpr double kInitialOpacity = 0.1;

/// One Gaussian per point, as the original 3DGS starts: isotropic scale = root of the mean squared distance to the 3
/// nearest neighbours, no rotation, opacity kInitialOpacity, colour as SH degree 0. shN has room for `sh_degree` and is
/// zero.
SplatCloud splats_from_points(const PointCloud& points, int sh_degree);

/// Float tensors on `device`; coefficients above the cloud's own degree are zero, and those above `sh_degree` dropped.
GaussianTensors to_tensors(const SplatCloud& cloud, int sh_degree, torch::Device device);

SplatCloud to_splat_cloud(const GaussianTensors& gaussians);

}  // namespace b3dgs
