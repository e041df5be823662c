// Times pieces of work on a device. An interface, so that callers do not depend on the device and tests can supply
// times.
#pragma once

#include <chrono>
#include <functional>
#include <memory>
#include <utility>
#include <vector>

#include "core/vec.h"

namespace b3dgs {

class KernelTimer {
 public:
  virtual ~KernelTimer() = default;

  /// Runs `work` and times it on the device. Need not wait for it: on a GPU pieces queue up, so that their times do not
  /// include launch latency.
  virtual void measure(const std::function<void()>& work) = 0;

  /// Waits for the device. Returns the times (ms) of the pieces measured since the last finish(), in order.
  virtual std::vector<double> finish() = 0;
};

/// For work that is complete when its function returns.
class SteadyTimer final : public KernelTimer {
 public:
  void measure(const std::function<void()>& work) override {
    const auto start = std::chrono::steady_clock::now();
    work();
    ms_.push_back(std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count());
  }
  std::vector<double> finish() override { return std::exchange(ms_, {}); }

 private:
  std::vector<double> ms_;
};

// Times work on a CUDA stream with two events around each piece.

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
