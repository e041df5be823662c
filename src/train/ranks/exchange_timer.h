// Times what a step spends in exchanges with other ranks.
#pragma once

#include <memory>
#include <utility>
#include <vector>

#include "train/timing/stage_timer.h"

namespace b3dgs {

class ExchangeTimer {
 public:
  /// Of one step, on this rank's device.
  struct Times {
    double exchange_ms = 0, step_ms = 0;
  };

  explicit ExchangeTimer(std::unique_ptr<StageClock> clock) : timer_(std::move(clock)) {}

  /// Times the step that begins, up to finish(). Otherwise the functions below cost one branch.
  void start() { timer_.start(StageTimes::Kind::kStep); }
  void finish() { timer_.finish(); }
  void cancel() { timer_.cancel(); }

  /// Calls exchange(), from when this rank is ready for it until the device has what others sent.
  template <class Exchange>
  auto time(Exchange&& exchange) {
    timer_.begin(Stage::kUpload);  // which one does not matter: there is no other
    auto result = exchange();
    timer_.end();
    return result;
  }

  /// Of the steps that the device has finished by now, oldest first; each is returned once. Does not wait.
  std::vector<Times> take() {
    std::vector<Times> taken;
    for (const StageTimes& step : timer_.take()) taken.push_back({step.wall_ms - step.host_ms(), step.wall_ms});
    return taken;
  }

 private:
  StageTimer timer_;
};

}  // namespace b3dgs
