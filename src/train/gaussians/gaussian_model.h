// Converts between point clouds, SplatCloud (host arrays) and parameter tensors.
#pragma once

#include <cstdint>
#include <vector>

#include "config/train_config.h"
#include "model/formats/splat_formats.h"
#include "raster/torch/rasterizer.h"
#include "scene/points/point_cloud.h"
#include "scene/scene.h"

namespace b3dgs {

/// One Gaussian per point, as in the original 3DGS: isotropic scale = root mean square distance to the 3 nearest
/// neighbours times `scale`, identity rotation, `opacity`, colour as SH degree 0. shN is zero, for degrees up to
/// `sh_degree`.
SplatCloud splats_from_points(const PointCloud& points, int sh_degree, double opacity = 0.1, double scale = 1);

/// Float tensors on `device` with SH coefficients up to `sh_degree`: missing ones are zero, higher ones are dropped.
GaussianTensors to_tensors(const SplatCloud& cloud, int sh_degree, torch::Device device);

/// The initial Gaussians of a training: those of --init_ply unchanged, or one per point of --init_ply, or else one per
/// point of the scene, with the opacity and scale that the options give; in the frame of the scene.
/// @throws InputError if there are no points or Gaussians
SplatCloud initial_splats(const TrainConfig& config, const Scene& scene);

/// Gaussians that may be floaters: training views constrain them so little that they may look wrong in others. One
/// contributes to a view if its blend weight is at least 1/255 in one of the pixels; masks are ignored. It can be in
/// several of these counts.
struct FloaterCount {
  std::int64_t unseen = 0;    // contribute to no view
  std::int64_t one_view = 0;  // contribute to exactly one
  std::int64_t close = 0;     // contribute to a view from a distance of less than a tenth of its median depth
  std::int64_t large = 0;     // contribute to a view in which 3 standard deviations exceed 0.3 times its longer side
};

/// Renders every view; on a GPU, waits for each. @throws what Rasterizer::project() and forward_splats() throw
FloaterCount count_floaters(Rasterizer& rasterizer, const GaussianTensors& gaussians,
                            const std::vector<CameraView>& views, const RenderSettings& settings);

}  // namespace b3dgs
