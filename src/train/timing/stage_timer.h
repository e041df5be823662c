// Times the stages of a step on the device without slowing it down: marks are queued with the work, and read while a
// later step is running. Outside of a timed step, begin() and end() cost one branch.
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
  std::array<std::optional<double>, kStageCount> ms{};  // of the stages that took place
  double wall_ms = 0;                                   // from start to end

  /// Wall time that belongs to no stage: the device waited for the host.
  double host_ms() const;
};

/// {"project": 0.1, ..., "host": 0.05}: the stages that took place, by name (raster/stages.h).
nlohmann::ordered_json stage_json(const StageTimes& times);

class StageTimer final : public StageRecorder {
 public:
  explicit StageTimer(std::unique_ptr<StageClock> clock) : clock_(std::move(clock)) {}

  /// Times what follows, up to finish().
  void start(StageTimes::Kind kind);
  void begin(Stage stage) override;
  void end() override;
  /// With several iterations in a step, times are divided by their number.
  void finish(int n_iterations = 1);
  /// Discards the marks since start().
  void cancel();

  /// Times that are known by now, oldest first; each is returned once. Does not wait.
  std::vector<StageTimes> take();
  /// Waits for the device; then all times that were not taken yet.
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
    int n_iterations = 1;
  };
  StageTimes read(const Record& record);

  std::unique_ptr<StageClock> clock_;
  std::deque<Record> finished_;
  std::optional<Record> open_;
  std::optional<Stage> stage_;
  int stage_from_ = 0;
};

/// The average step between two log lines. Only some steps are timed, but all rounds of density control, which are
/// rare: their time is averaged over all steps.
class StageAverage {
 public:
  void add(const StageTimes& times);
  /// The average over the `n_steps` since take() last returned something. If no step was timed since, returns nothing
  /// and keeps what was added.
  std::optional<StageTimes> take(int n_steps);

 private:
  std::array<std::optional<double>, kStageCount> step_sums_{};
  double wall_sum_ = 0, rounds_ms_ = 0;
  int n_timed_ = 0, n_rounds_ = 0;
};

}  // namespace b3dgs
