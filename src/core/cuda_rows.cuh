// Kernels with one thread per row: the row of a thread, and their launch.
#pragma once

#include <cstdint>
#include <type_traits>

#include "core/cuda_check.h"
#include "core/gpu_rows.h"

namespace b3dgs::cuda {

/// Returns the row of this thread, in a kernel launched by launch_rows<kThreads>(). May be past the last row.
template <int kThreads>
__device__ __forceinline__ std::int64_t own_row() {
  return static_cast<std::int64_t>(blockIdx.x) * kThreads + threadIdx.x;
}

/// Launches a kernel with a thread for each of `n_rows` rows, in blocks of kThreads. Does nothing if there are no rows.
/// Asynchronous. @throws CudaError
template <int kThreads, class Args>
void launch_rows(void (*kernel)(Args), const std::remove_const_t<Args>& args, std::int64_t n_rows,
                 cudaStream_t stream) {
  if (n_rows == 0) return;
  kernel<<<static_cast<unsigned>((n_rows + kThreads - 1) / kThreads), kThreads, 0, stream>>>(args);
  B3DGS_CUDA_CHECK_LAUNCH();
}

template <auto row, int kThreads, class Args>
__global__ void __launch_bounds__(kThreads) row_kernel(const __grid_constant__ Args args, const std::int64_t n) {
  const std::int64_t i = own_row<kThreads>();
  if (i < n) row(args, i);
}

/// Defines cuda::for_rows<row>() (gpu_rows.h) for rows that take `Args`, in blocks of `threads`. Use it at namespace
/// scope of b3dgs::cuda.
#define B3DGS_ROW_KERNEL(row, threads, Args)                                                     \
  template <>                                                                                    \
  void for_rows<row>(const Args& args, std::int64_t n, cudaStream_t stream) {                    \
    if (n == 0) return;                                                                          \
    row_kernel<row, threads, Args>                                                               \
        <<<static_cast<unsigned>((n + (threads)-1) / (threads)), threads, 0, stream>>>(args, n); \
    B3DGS_CUDA_CHECK_LAUNCH();                                                                   \
  }

}  // namespace b3dgs::cuda
