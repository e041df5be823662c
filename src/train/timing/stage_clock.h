// Marks points in time in a device's work queue.
#pragma once

#include <memory>

#include <torch/types.h>

namespace b3dgs {

class StageClock {
 public:
  virtual ~StageClock() = default;

  /// Records when the device gets to this point of its queue. Asynchronous. The caller owns the mark until release().
  virtual int mark() = 0;
  virtual void release(int mark) = 0;

  /// Whether the device has got to the mark.
  virtual bool has_reached(int mark) = 0;
  virtual void wait(int mark) = 0;

  /// Both marks must have been reached.
  virtual double ms_between(int from, int to) = 0;
};

/// CUDA events on LibTorch's current stream for a GPU, std::chrono::steady_clock for the CPU.
std::unique_ptr<StageClock> make_stage_clock(torch::Device device);

}  // namespace b3dgs
