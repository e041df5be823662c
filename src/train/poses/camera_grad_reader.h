// Reads the gradient with respect to the camera without stalling the GPU: it is copied to pinned memory, and read by
// the host while a later step is running.
#pragma once

#include <cuda_runtime_api.h>

#include <array>

#include "raster/args.h"

namespace b3dgs::cuda {

class CameraGradReader {
 public:
  CameraGradReader();
  ~CameraGradReader();
  CameraGradReader(const CameraGradReader&) = delete;
  CameraGradReader& operator=(const CameraGradReader&) = delete;

  /// Queues the copy of [kCameraGradients] in device memory. Asynchronous.
  void copy(const double* device, cudaStream_t stream);

  /// Waits for the last copy().
  std::array<double, kCameraGradients> wait() const;

 private:
  double* on_host_ = nullptr;  // pinned
  cudaEvent_t copied_ = nullptr;
};

}  // namespace b3dgs::cuda
