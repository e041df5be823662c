// Device functions shared by the backward blend kernels: gradients with respect to pixels, and additions to a splat's
// sums in memory.
#pragma once

#include "raster/cuda/passes.h"
#include "raster/math/blend.h"

namespace b3dgs::cuda {

/// Uses one vector atomic from compute capability 9.0 on, and four scalar ones before.
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

template <bool kWithDepth = true>
__device__ __forceinline__ void atomic_add(SplatGradSum* sum, const SplatGrad& grad) {
  auto* const words = reinterpret_cast<float4*>(sum);
  atomic_add(words, make_float4(grad.log_alpha, grad.mean_x, grad.mean_y, grad.cov_xx));
  atomic_add(words + 1, make_float4(grad.cov_xy, grad.cov_yy, grad.red, grad.green));
  if constexpr (kWithDepth) {
    atomic_add(words + 2, make_float4(grad.blue, grad.depth, 0, 0));
  } else {
    atomicAdd(&sum->sum.blue, grad.blue);
  }
}

/// Gradients of the loss with respect to one pixel's colour and depth.
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

/// Returns S of blend.h at the end of a pixel's list: the terms of the background and of the pixel's alpha.
__device__ __forceinline__ float loss_behind_list(const BlendBackwardArgs& args, std::int64_t pixel,
                                                  const PixelGrad& g) {
  const float background =
      g.color.x * args.background.x + g.color.y * args.background.y + g.color.z * args.background.z;
  const float grad_alpha = args.grad.alpha != nullptr ? args.grad.alpha[pixel] : 0.0f;
  return args.transmittance[pixel] * (background - grad_alpha);
}

}  // namespace b3dgs::cuda
