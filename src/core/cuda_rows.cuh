// Kernels with one thread per row: the row of a thread, and their launch.
#pragma once

#include <cstdint>
#include <type_traits>

#include "core/cuda_check.h"

namespace b3dgs::cuda {

/// The row of this thread, in a kernel that launch_rows<kThreads>() has launched. May be past the last row.
template <int kThreads>
__device__ __forceinline__ std::int64_t own_row() {
  return static_cast<std::int64_t>(blockIdx.x) * kThreads + threadIdx.x;
}

/// Launches a kernel with a thread for each of `n_rows` rows, in blocks of kThreads; none if there are no rows.
/// Asynchronous. @throws CudaError
template <int kThreads, class Args>
void launch_rows(void (*kernel)(Args), const std::remove_const_t<Args>& args, std::int64_t n_rows,
                 cudaStream_t stream) {
  if (n_rows == 0) return;
  kernel<<<static_cast<unsigned>((n_rows + kThreads - 1) / kThreads), kThreads, 0, stream>>>(args);
  B3DGS_CUDA_CHECK_LAUNCH();
}

}  // namespace b3dgs::cuda
