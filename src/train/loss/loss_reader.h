// Reads the loss of a step without stalling the GPU: it is copied to pinned memory after the kernels, and read by the
// host while a later step is running.
#pragma once

#include "train/loss/loss_cuda.h"

namespace b3dgs::cuda {

class LossReader {
 public:
  LossReader();
  ~LossReader();
  LossReader(const LossReader&) = delete;
  LossReader& operator=(const LossReader&) = delete;

  /// Queues loss, gradient and the copy of the value. Asynchronous.
  void compute(const LossArgs& args, cudaStream_t stream);

  /// Waits for the value of the last compute().
  LossValue wait() const;

 private:
  LossValue* on_device_ = nullptr;
  LossValue* on_host_ = nullptr;  // pinned
  cudaEvent_t copied_ = nullptr;
};

}  // namespace b3dgs::cuda
