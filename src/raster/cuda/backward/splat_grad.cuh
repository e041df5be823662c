// Adding a splat's gradient to its sums.
#pragma once

#include "raster/cuda/passes.h"
#include "raster/math/blend.h"

namespace b3dgs::cuda {

__device__ __forceinline__ void atomic_add(float4* sum, float4 value) {
#if __CUDA_ARCH__ >= 900
  atomicAdd(sum, value);
#else
  atomicAdd(&sum->x, value.x);
  atomicAdd(&sum->y, value.y);
  atomicAdd(&sum->z, value.z);
  atomicAdd(&sum->w, value.w);
#endif
}

__device__ __forceinline__ void atomic_add(SplatGradSum* sum, const SplatGrad& grad) {
  auto* const words = reinterpret_cast<float4*>(sum);
  atomic_add(words, make_float4(grad.q, grad.q_x, grad.q_y, grad.q_xx));
  atomic_add(words + 1, make_float4(grad.q_xy, grad.q_yy, grad.red, grad.green));
  atomic_add(words + 2, make_float4(grad.blue, grad.depth, 0, 0));
}

/// Adds one pixel's part to a splat's gradient.
__device__ __forceinline__ void accumulate(SplatGrad& sum, const Reach<float>& reach, const BlendGrad<float>& grad,
                                           float3 grad_color, float grad_depth) {
  const float along_x = grad.q * reach.pull_x, along_y = grad.q * reach.pull_y;
  sum.q += grad.q;
  sum.q_x += along_x;
  sum.q_y += along_y;
  sum.q_xx += along_x * reach.pull_x;
  sum.q_xy += along_x * reach.pull_y;
  sum.q_yy += along_y * reach.pull_y;
  sum.red += grad.weight * grad_color.x;
  sum.green += grad.weight * grad_color.y;
  sum.blue += grad.weight * grad_color.z;
  sum.depth += grad.weight * grad_depth;
}

/// Gradients by one pixel's colour and depth.
struct PixelGrad {
  float3 color;
  float depth;
};

__device__ __forceinline__ PixelGrad load_pixel_grad(const BlendBackwardArgs& args, std::int64_t pixel) {
  PixelGrad g{{0, 0, 0}, 0};
  if (args.grad.color != nullptr) {
    g.color = {args.grad.color[3 * pixel], args.grad.color[3 * pixel + 1], args.grad.color[3 * pixel + 2]};
  }
  if (args.grad.depth != nullptr) g.depth = args.grad.depth[pixel];
  return g;
}

/// What lies behind all splats of a pixel, seen through the loss: S in blend.h at the end of the list.
__device__ __forceinline__ float light_behind_all(const BlendBackwardArgs& args, std::int64_t pixel,
                                                  const PixelGrad& g) {
  const float shown = g.color.x * args.background.x + g.color.y * args.background.y + g.color.z * args.background.z;
  const float by_alpha = args.grad.alpha != nullptr ? args.grad.alpha[pixel] : 0.0f;
  return args.transmittance[pixel] * (shown - by_alpha);
}

}  // namespace b3dgs::cuda
