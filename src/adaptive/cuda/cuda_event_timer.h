// Times work on a CUDA stream with two events around each piece.
#pragma once

#include <cuda_runtime_api.h>

#include <memory>

#include "adaptive/kernel_timer.h"

namespace b3dgs {

/// Borrows the stream. All timed work must run on it.
class CudaEventTimer final : public KernelTimer {
 public:
  explicit CudaEventTimer(cudaStream_t stream);
  ~CudaEventTimer() override;

  void measure(const std::function<void()>& work) override;
  std::vector<double> finish() override;

 private:
  class Event;
  struct Span;

  cudaStream_t stream_;
  std::vector<Span> spans_;  // reused after finish()
  std::size_t n_used_ = 0;
};

}  // namespace b3dgs
