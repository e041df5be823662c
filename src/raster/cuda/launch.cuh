// How kernels are launched: the tile's size or the degree of harmonics as a template argument, and as many blocks as
// fit for pools.
#pragma once

#include "core/check.h"
#include "raster/cuda/device_buffer.h"
#include "raster/cuda/kernel_resources.h"
#include "raster/math/tiling.h"

namespace b3dgs::cuda {

/// Calls body(std::integral_constant<int, pixels>) for the tile's number of pixels, which is a block's number of
/// threads.
template <class Body>
void with_tile_pixels(const TileShape& tile, Body&& body) {
  B3DGS_CHECK(tile.width == 16 && (tile.height == 8 || tile.height == 16),
              "CUDA tiles are 16 x 8 or 16 x 16 px, found ", tile.width, " x ", tile.height);
  if (tile.height == 8) {
    body(std::integral_constant<int, 128>());
  } else {
    body(std::integral_constant<int, 256>());
  }
}

/// Calls body(std::integral_constant<int, degree>): where a kernel knows the degree, harmonics stay in registers.
template <class Body>
void with_sh_degree(int degree, Body&& body) {
  static_assert(kShDegreeMax == 3, "a case for each degree");
  switch (degree) {
    case 0:
      return body(std::integral_constant<int, 0>());
    case 1:
      return body(std::integral_constant<int, 1>());
    case 2:
      return body(std::integral_constant<int, 2>());
    case 3:
      return body(std::integral_constant<int, 3>());
    default:
      B3DGS_CHECK(false, "harmonics of degree ", degree);
  }
}

/// Blocks that are resident at once on the whole device.
template <class Kernel>
int resident_blocks(Kernel kernel, int threads, const LaunchContext& context) {
  int per_multiprocessor = 0;
  B3DGS_CUDA_CHECK(cudaOccupancyMaxActiveBlocksPerMultiprocessor(&per_multiprocessor, kernel, threads, 0));
  return per_multiprocessor * context.n_multiprocessors;
}

/// What blocks of `threads` threads of a __global__ function take on the current device.
template <class Kernel>
KernelResources kernel_resources(Kernel kernel, int threads) {
  cudaFuncAttributes attributes{};
  B3DGS_CUDA_CHECK(cudaFuncGetAttributes(&attributes, kernel));
  int device = 0, blocks = 0, threads_max = 0;
  B3DGS_CUDA_CHECK(cudaGetDevice(&device));
  B3DGS_CUDA_CHECK(cudaDeviceGetAttribute(&threads_max, cudaDevAttrMaxThreadsPerMultiProcessor, device));
  B3DGS_CUDA_CHECK(cudaOccupancyMaxActiveBlocksPerMultiprocessor(&blocks, kernel, threads, 0));
  return {threads,
          attributes.numRegs,
          static_cast<int>(attributes.sharedSizeBytes),
          static_cast<int>(attributes.localSizeBytes),
          blocks * threads,
          threads_max};
}

}  // namespace b3dgs::cuda
