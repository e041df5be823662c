#include "core/cuda_check.h"
#include "raster/cuda/gpu_support.h"

namespace b3dgs::cuda {
namespace {

__global__ void probe() {}

}  // namespace

GpuSupport query_gpu_support() {
  int device = 0;
  B3DGS_CUDA_CHECK(cudaGetDevice(&device));
  cudaDeviceProp properties{};
  B3DGS_CUDA_CHECK(cudaGetDeviceProperties(&properties, device));
  cudaFuncAttributes attributes{};
  const cudaError_t code = cudaFuncGetAttributes(&attributes, probe);
  GpuSupport gpu{properties.name, 10 * properties.major + properties.minor, {}, false};
  for (const int architecture : {__CUDA_ARCH_LIST__}) gpu.architectures.push_back(architecture / 10);  // 800, 900
  gpu.has_code = code != cudaErrorNoKernelImageForDevice && code != cudaErrorInvalidDeviceFunction &&
                 code != cudaErrorUnsupportedPtxVersion;
  if (!gpu.has_code) cudaGetLastError();  // clears the error, which the next check would report
  return gpu;
}

}  // namespace b3dgs::cuda
