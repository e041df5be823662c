#include "train/loss/loss_reader.h"

#include "core/cuda_check.h"

namespace b3dgs::cuda {

LossReader::LossReader() {
  B3DGS_CUDA_CHECK(cudaMalloc(reinterpret_cast<void**>(&on_device_), sizeof(LossValue)));
  B3DGS_CUDA_CHECK(cudaMallocHost(reinterpret_cast<void**>(&on_host_), sizeof(LossValue)));
  B3DGS_CUDA_CHECK(cudaEventCreateWithFlags(&copied_, cudaEventDisableTiming));
}

LossReader::~LossReader() {
  cudaEventDestroy(copied_);
  cudaFreeHost(on_host_);
  cudaFree(on_device_);
}

void LossReader::compute(const LossArgs& args, cudaStream_t stream) {
  compute_loss(args, on_device_, stream);
  B3DGS_CUDA_CHECK(cudaMemcpyAsync(on_host_, on_device_, sizeof(LossValue), cudaMemcpyDeviceToHost, stream));
  B3DGS_CUDA_CHECK(cudaEventRecord(copied_, stream));
}

LossValue LossReader::wait() const {
  B3DGS_CUDA_CHECK(cudaEventSynchronize(copied_));
  return *on_host_;
}

}  // namespace b3dgs::cuda
