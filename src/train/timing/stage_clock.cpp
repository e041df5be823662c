#include "train/timing/stage_clock.h"

#include <chrono>
#include <vector>

#include "core/check.h"

#if B3DGS_TORCH_CUDA
#include "raster/torch/torch_launch.h"
#include "train/timing/event_marks.h"
#endif

namespace b3dgs {
namespace {

/// Work on the CPU is done when its function returns: a mark is a clock reading.
class HostClock final : public StageClock {
 public:
  int mark() override {
    if (free_.empty()) {
      free_.push_back(static_cast<int>(times_.size()));
      times_.emplace_back();
    }
    const int mark = free_.back();
    free_.pop_back();
    times_[static_cast<std::size_t>(mark)] = Clock::now();
    return mark;
  }
  void release(int mark) override { free_.push_back(mark); }
  bool has_reached(int) override { return true; }
  void wait(int) override {}
  double ms_between(int from, int to) override {
    const auto at = [&](int mark) { return times_[static_cast<std::size_t>(mark)]; };
    return std::chrono::duration<double, std::milli>(at(to) - at(from)).count();
  }

 private:
  using Clock = std::chrono::steady_clock;
  std::vector<Clock::time_point> times_;
  std::vector<int> free_;
};

#if B3DGS_TORCH_CUDA
class DeviceClock final : public StageClock {
 public:
  int mark() override { return marks_.record(torch_launch_context().stream); }
  void release(int mark) override { marks_.release(mark); }
  bool has_reached(int mark) override { return marks_.has_reached(mark); }
  void wait(int mark) override { marks_.wait(mark); }
  double ms_between(int from, int to) override { return marks_.ms_between(from, to); }

 private:
  cuda::EventMarks marks_;
};
#endif

}  // namespace

std::unique_ptr<StageClock> make_stage_clock(torch::Device device) {
#if B3DGS_TORCH_CUDA
  if (device.is_cuda()) return std::make_unique<DeviceClock>();
#endif
  B3DGS_CHECK(device.is_cpu(), "this build has no stage clock for ", device.str());
  return std::make_unique<HostClock>();
}

}  // namespace b3dgs
