// Loads and stores rows of three or four floats of packed arrays, [N, 3] and [N, 4].
#pragma once

#include <cstdint>

#include "core/vec.h"

namespace b3dgs {

B3DGS_HD Vec3f load3(const float* array, std::int64_t i) {
  return {array[3 * i], array[3 * i + 1], array[3 * i + 2]};
}
B3DGS_HD void store3(float* array, std::int64_t i, Vec3f v) {
  array[3 * i] = v.x;
  array[3 * i + 1] = v.y;
  array[3 * i + 2] = v.z;
}

/// On a GPU, `array` must be aligned to 16 bytes.
B3DGS_HD Vec4f load4(const float* array, std::int64_t i) {
#if defined(__CUDA_ARCH__)
  const float4 row = reinterpret_cast<const float4*>(array)[i];
  return {row.x, row.y, row.z, row.w};
#else
  return {array[4 * i], array[4 * i + 1], array[4 * i + 2], array[4 * i + 3]};
#endif
}
B3DGS_HD void store4(float* array, std::int64_t i, Vec4f v) {
#if defined(__CUDA_ARCH__)
  reinterpret_cast<float4*>(array)[i] = make_float4(v.x, v.y, v.z, v.w);
#else
  array[4 * i] = v.x;
  array[4 * i + 1] = v.y;
  array[4 * i + 2] = v.z;
  array[4 * i + 3] = v.w;
#endif
}

}  // namespace b3dgs
