// The loss of a step, read by the host without stopping the device: copied to pinned memory behind the kernels, and
// looked at when a later step is under way.
#pragma once

#include "train/loss/loss_cuda.h"

namespace b3dgs::cuda {

class LossReader {
 public:
  LossReader();
  ~LossReader();
  LossReader(const LossReader&) = delete;
  LossReader& operator=(const LossReader&) = delete;

  /// Queues loss, gradient and the copy of the value. Does not wait.
  void compute(const LossArgs& args, cudaStream_t stream);

  /// Value of the last compute(), once it is there.
  LossValue wait() const;

 private:
  LossValue* on_device_ = nullptr;
  LossValue* on_host_ = nullptr;  // pinned
  cudaEvent_t copied_ = nullptr;
};

}  // namespace b3dgs::cuda
