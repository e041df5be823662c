#include "train/poses/camera_grad_reader.h"

#include <algorithm>

#include "core/cuda_check.h"

namespace b3dgs::cuda {

constexpr std::size_t kBytes = kCameraGradients * sizeof(double);

CameraGradReader::CameraGradReader() {
  B3DGS_CUDA_CHECK(cudaMallocHost(reinterpret_cast<void**>(&on_host_), kBytes));
  B3DGS_CUDA_CHECK(cudaEventCreateWithFlags(&copied_, cudaEventDisableTiming));
}

CameraGradReader::~CameraGradReader() {
  cudaEventDestroy(copied_);
  cudaFreeHost(on_host_);
}

void CameraGradReader::copy(const double* device, cudaStream_t stream) {
  B3DGS_CUDA_CHECK(cudaMemcpyAsync(on_host_, device, kBytes, cudaMemcpyDeviceToHost, stream));
  B3DGS_CUDA_CHECK(cudaEventRecord(copied_, stream));
}

std::array<double, kCameraGradients> CameraGradReader::wait() const {
  B3DGS_CUDA_CHECK(cudaEventSynchronize(copied_));
  std::array<double, kCameraGradients> values{};
  std::copy_n(on_host_, kCameraGradients, values.begin());
  return values;
}

}  // namespace b3dgs::cuda
