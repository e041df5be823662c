// The reference implementation. It computes the same image slowly and simply, in double, with torch operations and with
// autograd for its gradients. Every pixel is compared with every Gaussian in front of the near plane. There are no
// tiles, lists or packed structs, and it shares nothing with src/raster except the structs that describe the problem.
// Its constants are written out again, so that an accidental change in src/raster is noticed.
//
// For each pixel with centre p = (column + 0.5, row + 0.5), it computes:
//   camera frame    c = R mean + t, +x right, +y down, +z forward; visible if c.z >= near plane
//   lens            lenses other than the pinhole use their formula (raster/view_lens.h). J and the centre are those of
//                   the nearest point within the lens's limit. Fisheyes beyond 80 degrees and panoramas use |c| instead
//                   of c.z, and shrink Gaussians whose largest standard deviation is above half of it, without
//                   gradient through the factor
//   order           by c.z, equal depths by index
//   covariance      Q S S Q^T with Q of the normalised quaternion (w x y z) and S = diag(exp(log_scales))
//   projection      J R cov R^T J^T + 0.3 px^2 on the diagonal. J is evaluated at the centre, with x/z and y/z clamped
//                   to the image extended on each side by 0.3 times half its width or height (J only, not the centre)
//   alpha           min(0.99, opacity exp(-sigma)), sigma = d^T conic d / 2, d = p - mean2d; no gradient at the cap
//   antialiasing    scales sqrt(s^2 + filter^2); the opacity times the product of s / sqrt(s^2 + filter^2), and times
//                   sqrt(max(2.5e-5, determinant without the 0.3 px^2 / determinant with it))
//   tiles           a Gaussian is visible if the ellipse where alpha >= 1/255 meets the rectangle between the centres
//                   of a tile's corner pixels, including those outside the image. With Culling::kSquare, it is visible
//                   if its square meets a tile
//   skip, stop      alpha < 1/255 is skipped. The Gaussian that would bring the transmittance below 1e-4 ends the pixel
//                   and is not blended
//   colour          SH of the direction from the camera centre to the mean, + 0.5, at least 0
//   motion          if given, moves the camera: c = exp([w]) (R mean + t) + v with the matrix exponential of the cross
//                   product with w, and the camera centre where c is 0
// Decisions (order, skip, stop, clamps) depend on values and have no gradient.
#pragma once

#include <torch/types.h>

#include <string>
#include <vector>

#include "raster/args.h"
#include "raster/torch/rasterizer.h"

namespace b3dgs::test {

/// Relative distance from a threshold within which float arithmetic may decide differently.
inline constexpr double kDecisionBand = 1e-5;

/// A view rendered by the reference, as double tensors. The first four have their autograd graph.
struct DenseView {
  torch::Tensor color;           // [H, W, 3]
  torch::Tensor depth;           // [H, W] sum of weight times view-space z, or of weight over z (inverse_depth)
  torch::Tensor alpha;           // [H, W] 1 - final transmittance
  torch::Tensor means2d;         // [N, 2] px; undefined for Gaussians that are not visible
  torch::Tensor last_gaussians;  // [H, W] int64, index of the last Gaussian blended, -1 if none
  torch::Tensor n_blended;       // [H, W] int64, number of blended Gaussians
  torch::Tensor weights;         // [H W, M] blend weights of the Gaussians in front of the near plane, without graph
  torch::Tensor rows;            // [M] int64, indices of these Gaussians
  torch::Tensor radii;           // [N] int64, 3 standard deviations along the longer axis rounded up, 0 if not visible
  torch::Tensor contributes;     // [N] bool, blended into at least one pixel
  torch::Tensor seen;            // [N] bool, reaches 1/255 at some point of a tile's pixel centres, or of their hull
  torch::Tensor seen_nearly;     // [N] bool, does so within 0.01 px and a little more for large ones; includes `seen`
  torch::Tensor near_decision;   // [H, W] bool, an alpha or a transmittance within kDecisionBand of cutoff, cap or stop
  // Gaussians close to a decision that affects more than a pixel: near plane, order, frustum clamp, colour clamp,
  // rounding of the culling square. One line each. A scene with any of these cannot be used to check a float
  // rasterizer.
  std::vector<std::string> hazards;
};

/// Gradients of the loss with respect to the stored parameters and the projected centres, [N, 2] in 1/px. Double,
/// without graph.
struct DenseGradients {
  GaussianTensors parameters;
  torch::Tensor means2d;
};

/// Returns the parameters as double leaves that require gradients.
GaussianTensors to_dense_leaves(const GaussianTensors& gaussians);

/// Renders `leaves`, double tensors in the shapes of GaussianTensors. Tiles matter only for `seen` and for
/// Culling::kSquare, where a Gaussian reaches only the pixels of the tiles [floor((mean - radius) / tile), ceil((mean +
/// radius) / tile)), per axis and within the image. `motion`: [6] double, w (rad) and v (world units), or undefined for
/// none.
DenseView dense_render(const GaussianTensors& leaves, const CameraView& view, const RenderSettings& settings,
                       const torch::Tensor& motion = {});

/// Returns the gradients of sum(color * grad.color) + sum(depth * grad.depth) + sum(alpha * grad.alpha). An undefined
/// tensor means zero. Can be called several times for the same view.
DenseGradients dense_gradients(const GaussianTensors& leaves, const DenseView& view, const RenderedViewGrad& grad);

/// Returns the gradient of the same sum with respect to `motion`, a leaf that `view` was rendered with.
torch::Tensor dense_motion_gradient(const torch::Tensor& motion, const DenseView& view, const RenderedViewGrad& grad);

/// Returns rotation matrices [N, 3, 3] of quaternions [N, 4], w x y z.
torch::Tensor dense_rotations(const torch::Tensor& quats);

/// Centres of N Gaussians in a view.
struct DenseCenters {
  torch::Tensor rotation;  // [3, 3] world to camera
  torch::Tensor points;    // [N, 3] camera frame
  torch::Tensor depth;     // [N]
  torch::Tensor deeper;    // [N, 3] gradient of depth with respect to the point
  torch::Tensor jacobian;  // [N, 2, 3] of the pixel, as the lens is linearised; at the centre for pinholes
};
/// `means`: [N, 3] double
DenseCenters dense_centers(const torch::Tensor& means, const CameraView& view);

/// Returns real spherical harmonics up to `degree` at unit vectors [N, 3]: [N, (degree + 1)^2], with the
/// Condon-Shortley sign, in the order (0,0), (1,-1), (1,0), (1,1), (2,-2), ...
torch::Tensor dense_sh_basis(const torch::Tensor& directions, int degree);

}  // namespace b3dgs::test
