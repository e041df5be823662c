// Sums, products and votes within a warp; nothing about splats.
#pragma once

namespace b3dgs::cuda {

inline constexpr int kWarpSize = 32;
inline constexpr unsigned kFullWarp = 0xffffffffu;

__device__ __forceinline__ int lane_id() {
  return static_cast<int>(threadIdx.x & (kWarpSize - 1));
}

__device__ __forceinline__ float warp_sum(float value) {
#pragma unroll
  for (int offset = kWarpSize / 2; offset > 0; offset /= 2) value += __shfl_xor_sync(kFullWarp, value, offset);
  return value;
}

__device__ __forceinline__ int warp_max(int value) {
  return __reduce_max_sync(kFullWarp, value);
}

/// Product of the lanes up to and including each.
__device__ __forceinline__ float warp_prefix_product(float value) {
#pragma unroll
  for (int distance = 1; distance < kWarpSize; distance *= 2) {
    const float before = __shfl_up_sync(kFullWarp, value, distance);
    if (lane_id() >= distance) value *= before;
  }
  return value;
}

}  // namespace b3dgs::cuda
