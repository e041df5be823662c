// Times of pieces of work on a device. An interface, so that whoever measures knows no device and tests can invent
// times.
#pragma once

#include <chrono>
#include <functional>
#include <utility>
#include <vector>

namespace b3dgs {

class KernelTimer {
 public:
  virtual ~KernelTimer() = default;

  /// Runs `work` and takes its time on the device. Need not wait for it: on a GPU pieces queue up one behind the other,
  /// so that their times hold no latency of a launch.
  virtual void measure(const std::function<void()>& work) = 0;

  /// Waits for the device. Times (ms) of the pieces measured since the last finish(), in their order.
  virtual std::vector<double> finish() = 0;
};

/// For work that is done when its function returns.
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

}  // namespace b3dgs
