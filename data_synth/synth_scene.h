// Scenes with a known ground truth: Gaussians, cameras, and the points that structure from motion or LiDAR would yield.
#pragma once

#include <array>
#include <vector>

#include "data_synth/synth_config.h"
#include "model/formats/splat_formats.h"
#include "raster/math/opacity.h"
#include "scene/cameras/camera.h"
#include "scene/images/image.h"
#include "scene/points/point_cloud.h"

namespace b3dgs {

struct SynthScene {
  SplatCloud truth;             // the Gaussians that the images are rendered from
  PointCloud points;            // the points that training starts from
  std::vector<Camera> cameras;  // in the order of the image names
};

/// Makes textured solids on a ground plane, with cameras around them. Points are noisy samples of the Gaussians.
SynthScene make_orbit(const SynthConfig& config);

/// Makes a road between facades as seen by a LiDAR, with a camera driving along +z. The true Gaussians are on the same
/// surfaces as the points, but not at the points, and there are half as many. With config.truth "points", they are
/// centred at the points.
SynthScene make_street(const SynthConfig& config);

/// Makes the scene called config.scene, with the lens of the config.
SynthScene make_scene(const SynthConfig& config);

/// Renders a view with the CPU rasterizer on a black background. If the camera is not a pinhole, the image is resampled
/// from pinhole views of three times the size, so that it does not depend on the projection through lenses.
Image8 render_truth(const SplatCloud& truth, const Camera& camera);

/// Convert between a colour value in [0, 1] and a coefficient of SH degree 0.
float sh0_from_color(double color);
double color_from_sh0(float coefficient);

}  // namespace b3dgs
