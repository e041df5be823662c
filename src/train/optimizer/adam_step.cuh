// Adam on the GPU, for one float.
#pragma once

#include "train/optimizer/adam_args.h"

namespace b3dgs::cuda {

/// Takes an Adam step of one float. Multiply-adds are fused exactly as written, so that every kernel computes the same
/// bits. Square root and division are the device's fast approximations, so the step (not the parameter) has an error of
/// a few ulp. Second moments below 1e-38 are flushed to 0 in the square root, which is negligible beside epsilon.
__device__ __forceinline__ void step_one(const AdamStepSize& size, float grad, float& param, float& m, float& v,
                                         const AdamRule& rule = {}) {
  m = __fmaf_rn(rule.beta1, m, __fmul_rn(rule.rest1, grad));
  v = __fmaf_rn(rule.beta2, v, __fmul_rn(__fmul_rn(rule.rest2, grad), grad));
  float root;
  asm("sqrt.approx.ftz.f32 %0, %1;" : "=f"(root) : "f"(v));
  const float divisor = __fmaf_rn(root, size.inverse_root_bias2, rule.epsilon);
  param = __fsub_rn(param, __fdividef(__fmul_rn(size.step_size, m), divisor));
}

/// Takes the step of a row of `kFloats` floats. All are read before any is written, so that no load waits for another
/// one.
template <int kFloats>
__device__ __forceinline__ void step_row(const AdamArgs& args, std::int64_t row, const float (&grad)[kFloats],
                                         const AdamRule& rule = {}) {
  float param[kFloats], m[kFloats], v[kFloats];
#pragma unroll
  for (int k = 0; k < kFloats; ++k) {
    param[k] = args.param[kFloats * row + k];
    m[k] = args.m[kFloats * row + k];
    v[k] = args.v[kFloats * row + k];
  }
#pragma unroll
  for (int k = 0; k < kFloats; ++k) {
    step_one(args.size, grad[k], param[k], m[k], v[k], rule);
    args.param[kFloats * row + k] = param[k];
    args.m[kFloats * row + k] = m[k];
    args.v[kFloats * row + k] = v[k];
  }
}

}  // namespace b3dgs::cuda
