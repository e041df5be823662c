// Rows of three floats in device memory.
#pragma once

#include <cstdint>

#include "raster/vec.h"

namespace b3dgs::cuda {

__device__ __forceinline__ Vec3f load3(const float* array, std::int64_t i) {
  return {array[3 * i], array[3 * i + 1], array[3 * i + 2]};
}
__device__ __forceinline__ void store3(float* array, std::int64_t i, Vec3f v) {
  array[3 * i] = v.x;
  array[3 * i + 1] = v.y;
  array[3 * i + 2] = v.z;
}

}  // namespace b3dgs::cuda
