// How long the stages of a step take on the device, without slowing it: marks go into the queue beside the work, and
// are read when a later step is under way. What is not timed costs nothing but a branch.
#pragma once

#include <deque>
#include <memory>
#include <optional>
#include <vector>

#include <nlohmann/json.hpp>

#include "raster/stages.h"
#include "train/timing/stage_clock.h"

namespace b3dgs {

struct StageTimes {
  enum class Kind { kStep, kDensityRound };

  Kind kind = Kind::kStep;
  std::array<std::optional<double>, kStageCount> ms{};  // of the stages that there were
  double wall_ms = 0;                                   // from beginning to end

  /// Of the wall time, what belongs to no stage: the device waited for the host.
  double host_ms() const;
};

/// {"project": 0.1, ..., "host": 0.05}: stages that there were, by their names.
nlohmann::ordered_json stage_json(const StageTimes& times);

class StageTimer final : public StageRecorder {
 public:
  explicit StageTimer(std::unique_ptr<StageClock> clock) : clock_(std::move(clock)) {}

  /// From here to finish() marks are taken.
  void start(StageTimes::Kind kind);
  void begin(Stage stage) override;
  void end() override;
  void finish();
  /// Forgets what was timed since start().
  void cancel();

  /// What is known by now, oldest first, each once. Does not wait.
  std::vector<StageTimes> take();
  /// All that was timed and not yet taken, when the device has got there.
  std::vector<StageTimes> wait();

 private:
  struct Span {
    Stage stage;
    int from, to;  // marks
  };
  struct Record {
    StageTimes::Kind kind{};
    int from = 0, to = 0;  // marks
    std::vector<Span> spans;
  };
  StageTimes read(const Record& record);

  std::unique_ptr<StageClock> clock_;
  std::deque<Record> finished_;
  std::optional<Record> open_;
  std::optional<Stage> stage_;
  int stage_from_ = 0;
};

/// The mean step between two lines of the log. Some steps are timed, but all rounds of density control, which are rare:
/// their time is shared out among all steps.
class StageAverage {
 public:
  void add(const StageTimes& times);
  /// Over the `n_steps` since the last time that there was something; nothing, and nothing changes, if no step has been
  /// timed since.
  std::optional<StageTimes> take(int n_steps);

 private:
  std::array<std::optional<double>, kStageCount> step_sums_{};
  double wall_sum_ = 0, rounds_ms_ = 0;
  int n_timed_ = 0, n_rounds_ = 0;
};

}  // namespace b3dgs
