// Constants shared by all kernels (forward and backward, CPU and CUDA). Changing one changes images.
#pragma once

#include <cstdint>

namespace b3dgs {

// A splat is not blended where its alpha is below this value, which is less than one step of an 8-bit channel.
inline constexpr float kAlphaMin = 1.0f / 255.0f;
inline constexpr float kLog2AlphaMin = -7.99435344f;  // log2(1/255)
// Upper limit of alpha, because the backward pass divides by 1 - alpha.
inline constexpr float kAlphaMax = 0.99f;
// A splat that would bring a pixel's transmittance below this value is not blended and finishes the pixel. Two splats
// with alpha 0.99 are enough.
inline constexpr float kTransmittanceMin = 1e-4f;
// log2(e) / 2 turns exp(-d^T K d / 2) into exp2(-d^T conic d).
inline constexpr float kConicScale = 0.721347520f;
// Added to the diagonal of the 2D covariance (px^2), so that no splat gets thinner than about a pixel.
inline constexpr float kCovarianceBlur = 0.3f;
// The Jacobian of the projection is evaluated at most this fraction of half the image width (or height) outside the
// image, because the affine approximation of EWA splatting grows without bound farther out.
inline constexpr float kFrustumMargin = 0.3f;
inline constexpr float kNearPlane = 0.2f;     // world units; default, as in the original rasterizer
inline constexpr float kSquareSigmas = 3.0f;  // half side of the original's culling square, in standard deviations
inline constexpr int kShDegreeMax = 3;

// A Gaussian that exceeds one of these limits is invalid, like one that contains NaN. No Gaussian in a working
// optimisation gets that large. Within the limits, sums over a list of splats and their gradients stay finite in single
// precision.
inline constexpr float kRadiusMax = 1e9f;             // px
inline constexpr float kDepthMax = 1e12f;             // world units
inline constexpr float kColorMax = 1e9f;              // 1 is white
inline constexpr float kInverseQuatLengthMax = 1e9f;  // 1 / length of the stored quaternion

}  // namespace b3dgs
