// Times pieces of work on a device. An interface, so that tests can supply times.
#pragma once

#include <functional>
#include <vector>

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

}  // namespace b3dgs
