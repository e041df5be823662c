// Sums, products and bit operations across the lanes of a warp. All lanes must call them.
#pragma once

#include <cooperative_groups.h>
#include <cooperative_groups/reduce.h>

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

// For integers: one instruction from compute capability 8.0 on.
__device__ __forceinline__ unsigned warp_sum(unsigned value) {
  namespace groups = cooperative_groups;
  return groups::reduce(groups::tiled_partition<kWarpSize>(groups::this_thread_block()), value,
                        groups::plus<unsigned>());
}
__device__ __forceinline__ int warp_max(int value) {
  namespace groups = cooperative_groups;
  return groups::reduce(groups::tiled_partition<kWarpSize>(groups::this_thread_block()), value, groups::greater<int>());
}

/// Computes four sums with half the shuffles. In the first two rounds lanes exchange two values, then one, so that each
/// lane continues with one of the four sums. The last step broadcasts them.
__device__ __forceinline__ float4 warp_sum(float4 value) {
  const int lane = lane_id();
  const bool upper = (lane & 1) != 0, far = (lane & 2) != 0;
  float a = upper ? value.z : value.x, b = upper ? value.w : value.y;
  a += __shfl_xor_sync(kFullWarp, upper ? value.x : value.z, 1);
  b += __shfl_xor_sync(kFullWarp, upper ? value.y : value.w, 1);
  float sum = far ? b : a;
  sum += __shfl_xor_sync(kFullWarp, far ? a : b, 2);
#pragma unroll
  for (int offset = 4; offset < kWarpSize; offset *= 2) sum += __shfl_xor_sync(kFullWarp, sum, offset);
  // Lane 0 has x, lane 2 y, lane 1 z, lane 3 w.
  return make_float4(__shfl_sync(kFullWarp, sum, 0), __shfl_sync(kFullWarp, sum, 2), __shfl_sync(kFullWarp, sum, 1),
                     __shfl_sync(kFullWarp, sum, 3));
}

/// Returns the inclusive prefix over the lanes, combined in a tree. `op` must be associative and commutative.
template <class Value, class Op>
__device__ __forceinline__ Value warp_prefix(Value value, Op&& op) {
#pragma unroll
  for (int distance = 1; distance < kWarpSize; distance *= 2) {
    const Value before = __shfl_up_sync(kFullWarp, value, distance);
    if (lane_id() >= distance) value = op(value, before);
  }
  return value;
}

}  // namespace b3dgs::cuda
