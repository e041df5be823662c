// Times the phases of a step or of a round of density control with several ranks, on this rank's device.
#pragma once

#include <array>
#include <cstddef>
#include <memory>
#include <optional>
#include <type_traits>
#include <utility>
#include <vector>

#include "train/timing/stage_timer.h"

namespace b3dgs {

/// `Phase`: an enum whose enumerators count from 0 to kCount - 1.
template <class Phase, std::size_t kCount>
class PhaseTimer {
 public:
  struct Times {
    std::array<double, kCount> ms{};
    double wall_ms = 0;  // from start() to finish()
  };

  explicit PhaseTimer(std::unique_ptr<StageClock> clock) : timer_(std::move(clock)) {}

  /// Times what follows, up to finish(). Otherwise all functions cost one branch, and none ever waits for the device.
  void start() { timer_.start(StageTimes::Kind::kStep); }
  void finish() {
    timer_.finish();
    phase_.reset();
  }
  void cancel() {
    timer_.cancel();
    phase_.reset();
  }

  /// Work queued from now on belongs to `phase`, and so does waiting.
  void begin(Phase phase) {
    phase_ = phase;
    timer_.begin(slot(phase));
  }

  /// Calls work() in `phase`; then the phase before goes on.
  template <class Work>
  auto time(Phase phase, Work&& work) {
    const std::optional<Phase> before = phase_;
    begin(phase);
    if constexpr (std::is_void_v<decltype(work())>) {
      work();
      resume(before);
    } else {
      auto result = work();
      resume(before);
      return result;
    }
  }

  /// Of what the device has finished by now, oldest first; each is returned once. Does not wait.
  std::vector<Times> take() {
    std::vector<Times> taken;
    for (const StageTimes& known : timer_.take()) {
      Times& times = taken.emplace_back();
      for (std::size_t i = 0; i < kCount; ++i) times.ms[i] = known.ms[i].value_or(0);
      times.wall_ms = known.wall_ms;
    }
    return taken;
  }

 private:
  static_assert(kCount <= kStageCount, "a phase takes the place of a stage");
  static Stage slot(Phase phase) { return static_cast<Stage>(phase); }
  void resume(std::optional<Phase> phase) {
    if (phase) return begin(*phase);
    timer_.end();
    phase_.reset();
  }

  StageTimer timer_;
  std::optional<Phase> phase_;
};

}  // namespace b3dgs
