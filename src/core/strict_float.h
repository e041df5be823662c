// A float type that rounds after every operation. A GPU compiler may contract a multiplication and an addition into one
// fused operation with a single rounding, and may decide differently wherever a function is inlined. Kernels that must
// compute identical bits use this type. For CPU code, cmake/CompileOptions.cmake disables contraction.
#pragma once

#include <cmath>

#include "core/vec.h"

namespace b3dgs {
namespace detail {

#if defined(__CUDA_ARCH__)
__device__ __forceinline__ float rounded_sum(float a, float b) {
  return __fadd_rn(a, b);
}
__device__ __forceinline__ float rounded_product(float a, float b) {
  return __fmul_rn(a, b);
}
__device__ __forceinline__ float rounded_quotient(float a, float b) {
  return a / b;  // like __fdiv_rn(), by nvcc's default -prec-div=true; a constant power of two becomes a factor
}
__device__ __forceinline__ float rounded_root(float a) {
  return __fsqrt_rn(a);
}
#else
B3DGS_HD float rounded_sum(float a, float b) {
  return a + b;
}
B3DGS_HD float rounded_product(float a, float b) {
  return a * b;
}
B3DGS_HD float rounded_quotient(float a, float b) {
  return a / b;
}
B3DGS_HD float rounded_root(float a) {
  return std::sqrt(a);
}
#endif

}  // namespace detail

struct StrictFloat {
  float value;

  B3DGS_HD StrictFloat(float v) : value(v) {}

  friend B3DGS_HD StrictFloat operator-(StrictFloat a) { return -a.value; }
  friend B3DGS_HD StrictFloat operator+(StrictFloat a, StrictFloat b) { return detail::rounded_sum(a.value, b.value); }
  friend B3DGS_HD StrictFloat operator-(StrictFloat a, StrictFloat b) { return detail::rounded_sum(a.value, -b.value); }
  friend B3DGS_HD StrictFloat operator*(StrictFloat a, StrictFloat b) {
    return detail::rounded_product(a.value, b.value);
  }
  friend B3DGS_HD StrictFloat operator/(StrictFloat a, StrictFloat b) {
    return detail::rounded_quotient(a.value, b.value);
  }
  friend B3DGS_HD StrictFloat sqrt(StrictFloat a) { return detail::rounded_root(a.value); }

  friend B3DGS_HD bool operator<(StrictFloat a, StrictFloat b) { return a.value < b.value; }
  friend B3DGS_HD bool operator>(StrictFloat a, StrictFloat b) { return a.value > b.value; }
  friend B3DGS_HD bool operator>=(StrictFloat a, StrictFloat b) { return a.value >= b.value; }
};

}  // namespace b3dgs
