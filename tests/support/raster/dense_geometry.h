// Depth, normals and confidence computed slowly and simply in double, as a reference for the geometry pass. Works on
// the weights of a view of the dense reference, and shares nothing with src/raster except the structs that describe the
// problem.
//
// For each Gaussian, with covariance C in the camera frame, A = inverse of C, centre mu, depth z and r0 = mu / z:
//   peak         on the ray t r, the density is largest at t = (r A mu) / (r A r), which is z for r0
//   plane        1 / t is linearised around r0: slope m = A r0 / (r0 A mu), and by the inverse of the Jacobian of
//                (pixel, depth) around the centre. Where t leaves z (1 +- 0.2), it is z
//   normal       -A r0 / |A r0|
//   thickness    variance 1 / (r0 A r0 z^2) of depth over z, at most 1
// and for each pixel, with weights w_i and T_i = 1 - sum of the weights in front:
//   share        surface: length of [T_i - w_i, T_i] within [0.4, 0.6]. median: 1 where 0.5 is in it. mean: w_i
//   depth        1 over the mean of 1 / t by shares. mean: mean of z
//   confidence   1 / (1 + s^2 / 0.01^2), s^2 the variance of the averaged values over their mean's square, plus the
//   mean
//                of the thicknesses
//   nothing      all 0 where the last T is 0.5 or more
#pragma once

#include "raster/geometry.h"
#include "support/raster/dense_reference.h"

namespace b3dgs::test {

/// Double tensors.
struct DenseSurface {
  torch::Tensor depth;          // [H, W]
  torch::Tensor normal;         // [H, W, 3]
  torch::Tensor confidence;     // [H, W]
  torch::Tensor near_decision;  // [H, W] bool, also those of DenseView
};

DenseSurface dense_surface(const GaussianTensors& leaves, const CameraView& view, const RenderSettings& settings,
                           const DenseView& rendered, DepthKind kind);

}  // namespace b3dgs::test
