// Conversions between point clouds, SplatCloud (host arrays) and parameter tensors, and statistics of a model.
#pragma once

#include <cstdint>
#include <vector>

#include "config/train_config.h"
#include "model/formats/splat_formats.h"
#include "raster/torch/rasterizer.h"
#include "scene/points/point_cloud.h"
#include "scene/scene.h"

namespace b3dgs {

/// Returns one Gaussian per point, as in the original 3DGS, with isotropic scale (root mean square distance to the 3
/// nearest neighbours times `scale`), identity rotation, `opacity`, and the colour as SH degree 0. shN is zero, for
/// degrees up to `sh_degree`.
SplatCloud splats_from_points(const PointCloud& points, int sh_degree, double opacity = 0.1, double scale = 1);

/// Returns float tensors on `device` with SH coefficients up to `sh_degree`. Missing coefficients are zero, and higher
/// degrees are dropped.
GaussianTensors to_tensors(const SplatCloud& cloud, int sh_degree, torch::Device device);

/// Returns the initial Gaussians of a training, in the frame of the scene. These are the Gaussians of --init_ply
/// unchanged, or one per point of --init_ply or otherwise of the scene, with the opacity and scale from the options.
/// @throws InputError if there are no points or Gaussians
SplatCloud initial_splats(const TrainConfig& config, const Scene& scene);

/// Gaussians that may be floaters: training views constrain them so little that they may look wrong in other views. A
/// Gaussian contributes to a view if its blend weight is at least 1/255 in one of the pixels. Masks are ignored. Each
/// tensor is [N] bool, and a Gaussian can be in several.
struct Floaters {
  torch::Tensor unseen;    // contributes to no view
  torch::Tensor one_view;  // contributes to exactly one view
  torch::Tensor close;     // contributes to a view whose camera is closer than a tenth of the view's median depth
  torch::Tensor large;     // contributes to a view in which 3 standard deviations exceed 0.3 times its longer side
};

/// Renders every view and finds the floaters. On a GPU, waits for each view. @throws the errors of
/// Rasterizer::project() and forward_splats()
Floaters find_floaters(Rasterizer& rasterizer, const GaussianTensors& gaussians, const std::vector<CameraView>& views,
                       const RenderSettings& settings);

/// The numbers of floaters of each kind.
struct FloaterCount {
  std::int64_t unseen = 0, one_view = 0, close = 0, large = 0;
};
FloaterCount count_floaters(Rasterizer& rasterizer, const GaussianTensors& gaussians,
                            const std::vector<CameraView>& views, const RenderSettings& settings);

}  // namespace b3dgs
