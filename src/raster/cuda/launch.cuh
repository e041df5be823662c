// Launch helpers for kernels and rows, and for values that are constant in a view as template arguments.
#pragma once

#include <type_traits>

#include "core/check.h"
#include "core/cuda_rows.cuh"
#include "raster/constants.h"
#include "raster/cuda/device_buffer.h"
#include "raster/math/lens.h"

namespace b3dgs::cuda {

/// Queues a kernel, unless there are no blocks. @throws CudaError
template <class... Params, class... Args>
void launch_blocks(void (*kernel)(Params...), std::int64_t n_blocks, int threads, const LaunchContext& context,
                   const Args&... args) {
  if (n_blocks == 0) return;
  kernel<<<static_cast<unsigned>(n_blocks), threads, 0, context.stream>>>(args...);
  B3DGS_CUDA_CHECK_LAUNCH();
}

/// Returns the number of blocks for n threads, entries or tasks, with `of_block` in each block.
inline std::int64_t n_blocks(std::int64_t n, int of_block) {
  return (n + of_block - 1) / of_block;
}

template <int kThreads, class Row>
__global__ void __launch_bounds__(kThreads) each_row_kernel(const __grid_constant__ Row row, std::int64_t n_rows) {
  const std::int64_t i = own_row<kThreads>();
  if (i < n_rows) row(i);
}

/// Calls row(i), a device lambda, for each i in [0, n_rows) with a thread each. Asynchronous.
template <int kThreads = 256, class Row>
void each_row(std::int64_t n_rows, const LaunchContext& context, const Row& row) {
  launch_blocks(each_row_kernel<kThreads, Row>, n_blocks(n_rows, kThreads), kThreads, context, row, n_rows);
}

/// Calls body(std::integral_constant<int, degree>). With a constant degree, SH basis values stay in registers. Degrees
/// below kMin are not instantiated.
template <int kMin = 0, class Body>
void with_sh_degree(int degree, Body&& body) {
  if constexpr (kMin > kShDegreeMax) {
    B3DGS_CHECK(false, "no kernel for SH degree ", degree);
  } else if (degree == kMin) {
    body(std::integral_constant<int, kMin>());
  } else {
    with_sh_degree<kMin + 1>(degree, body);
  }
}

/// Calls body(degree, antialiasing, lens). The first two are constants as above, the last is a Pinhole or a ViewLens.
template <int kMinDegree = 0, class Body>
void with_constants(int sh_degree, bool antialiasing, const ViewLens& view_lens, Body&& body) {
  with_sh_degree<kMinDegree>(sh_degree, [&](auto degree) {
    with_lens(view_lens, [&](const auto& lens) {
      if (antialiasing) {
        body(degree, std::true_type(), lens);
      } else {
        body(degree, std::false_type(), lens);
      }
    });
  });
}

}  // namespace b3dgs::cuda
