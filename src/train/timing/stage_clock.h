// Points in time on a device's queue of work.
#pragma once

#include <memory>

#include <torch/types.h>

namespace b3dgs {

class StageClock {
 public:
  virtual ~StageClock() = default;

  /// Notes when the device gets to this place in its queue. Does not wait. The mark is the caller's until released.
  virtual int mark() = 0;
  virtual void release(int mark) = 0;

  /// Whether the device has got there.
  virtual bool has_reached(int mark) = 0;
  virtual void wait(int mark) = 0;

  /// Of two marks that were reached.
  virtual double ms_between(int from, int to) = 0;
};

/// Events on LibTorch's current stream for a GPU, the time of day for the CPU.
std::unique_ptr<StageClock> make_stage_clock(torch::Device device);

}  // namespace b3dgs
