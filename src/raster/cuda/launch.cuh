// Launch helpers: SH degree as a template argument; number of resident blocks.
#pragma once

#include "core/check.h"
#include "raster/cuda/device_buffer.h"
#include "raster/math/tiling.h"

namespace b3dgs::cuda {

/// Calls body(std::integral_constant<int, degree>): with a constant degree, SH basis values stay in registers. Degrees
/// below kMin are not instantiated.
template <int kMin = 0, class Body>
void with_sh_degree(int degree, Body&& body) {
  static_assert(kShDegreeMax == 3, "one case per degree");
  switch (degree) {
    case 0:
      if constexpr (kMin <= 0) return body(std::integral_constant<int, 0>());
      break;
    case 1:
      return body(std::integral_constant<int, 1>());
    case 2:
      return body(std::integral_constant<int, 2>());
    case 3:
      return body(std::integral_constant<int, 3>());
    default:
      break;
  }
  B3DGS_CHECK(false, "SH degree is ", degree, ", expected ", kMin, " to ", kShDegreeMax);
}

/// Sets a task counter to 0.
inline void reset_tasks(std::int32_t* next_task, const LaunchContext& context) {
  B3DGS_CUDA_CHECK(cudaMemsetAsync(next_task, 0, sizeof(std::int32_t), context.stream));
}

/// Number of blocks that are resident at the same time on the whole device.
template <class Kernel>
int resident_blocks(Kernel kernel, int threads, const LaunchContext& context) {
  int per_multiprocessor = 0;
  B3DGS_CUDA_CHECK(cudaOccupancyMaxActiveBlocksPerMultiprocessor(&per_multiprocessor, kernel, threads, 0));
  return per_multiprocessor * context.n_multiprocessors;
}

}  // namespace b3dgs::cuda
