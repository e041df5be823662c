// The numbers on which every kernel, forward and backward, CPU and CUDA, has to agree.
#pragma once

#include <cstdint>

namespace b3dgs {

inline constexpr float kAlphaMin = 1.0f / 255.0f;     // below one step of an 8-bit channel: not blended
inline constexpr float kLog2AlphaMin = -7.99435344f;  // log2(1/255)
// Cap on alpha: keeps 1 - alpha away from 0, by which the backward pass divides.
inline constexpr float kAlphaMax = 0.99f;
// A pixel is finished before the splat that would take its transmittance below this. Two splats at the cap reach it.
inline constexpr float kTransmittanceMin = 1e-4f;
// log2(e) / 2: from exp(-d^T K d / 2) to exp2(-d^T conic d).
inline constexpr float kConicScale = 0.721347520f;
inline constexpr float kCovarianceBlur =
    0.3f;  // px^2 on the 2D covariance's diagonal: no splat is thinner than about a pixel
// The projection is linearised no further outside the image than this share of half its width (or height): beyond, the
// affine approximation of EWA splatting grows without bound.
inline constexpr float kFrustumMargin = 0.3f;
inline constexpr float kNearPlane = 0.2f;  // world units; the original rasterizer's, and the default
inline constexpr float kRadiusMax = 1e9f;  // px; nothing that is being learned is that large: a fault, as NaN is
// As kRadiusMax. With these, sums over a list of splats and their gradients stay finite in single precision.
inline constexpr float kDepthMax = 1e12f;             // world units
inline constexpr float kColorMax = 1e9f;              // 1 is white
inline constexpr float kInverseQuatLengthMax = 1e9f;  // of a stored quaternion
inline constexpr float kSquareSigmas = 3.0f;  // half side of the original's culling square, in standard deviations
inline constexpr int kShDegreeMax = 3;

}  // namespace b3dgs
