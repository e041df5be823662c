// Scenes with a known answer: Gaussians, cameras that look at them, and the points that structure from motion or LiDAR
// would have found.
#pragma once

#include <array>
#include <vector>

#include "data_synth/synth_config.h"
#include "model/splat_cloud.h"
#include "raster/math/opacity.h"
#include "scene/cameras/camera.h"
#include "scene/images/image.h"
#include "scene/point_cloud.h"

namespace b3dgs {

struct SynthScene {
  SplatCloud truth;             // what the images show
  PointCloud points;            // what training starts from
  std::vector<Camera> cameras;  // in the order of the image names
};

/// Textured solids on a ground, cameras around them. Points are noisy samples of the Gaussians.
SynthScene make_orbit(const SynthConfig& config);

/// A road between facades as a LiDAR sees it, the camera driving along +z. The truth is made of other Gaussians than
/// the points give, half as many; with config.truth "points" the points are the Gaussians' centres.
SynthScene make_street(const SynthConfig& config);

/// The scene that config.scene names.
SynthScene make_scene(const SynthConfig& config);

/// Renders one camera with the CPU rasterizer, on black.
Image8 render_truth(const SplatCloud& truth, const Camera& camera);

/// Colour in [0, 1] as the coefficient of SH degree 0, and back.
float sh0_from_color(double color);
double color_from_sh0(float coefficient);

}  // namespace b3dgs
