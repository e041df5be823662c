// Where the time of a training goes: the stages of its steps, and training against output.
//
// A GPU works asynchronously: a host clock around a call measures only the queueing.
#pragma once

#include <torch/types.h>

#include <deque>
#include <functional>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <utility>
#include <vector>

#include "raster/stages.h"

namespace b3dgs {

/// A point in a device's queue of work.
class StageMark {
 public:
  virtual ~StageMark() = default;
  /// Whether the device has got there.
  virtual bool is_reached() const = 0;
  virtual void wait() const = 0;
  /// From an earlier mark of the same clock. Both must have been reached.
  virtual double ms_since(const StageMark& from) const = 0;
};

/// Makes a mark at the end of the queue. Asynchronous.
using StageClock = std::function<std::unique_ptr<StageMark>()>;

/// CUDA events on LibTorch's current stream for a GPU, std::chrono::steady_clock for the CPU.
StageClock make_stage_clock(torch::Device device);

struct StageTimes {
  enum class Kind { kStep, kDensityRound };

  Kind kind = Kind::kStep;
  std::array<std::optional<double>, kStageCount> ms{};  // of the stages that took place
  double wall_ms = 0;                                   // from start to end

  /// Adds `share` times what others took.
  void add(const StageTimes& others, double share);
  /// Wall time that belongs to no stage: the device waited for the host.
  double host_ms() const;
};

/// {"project": 0.1, ..., "host": 0.05}: the stages that took place, by name (raster/stages.h).
nlohmann::ordered_json stage_json(const StageTimes& times);

/// Times the stages of a step on the device without slowing it down: marks are queued with the work, and read while a
/// later step is running. Outside of a timed step, begin() and end() cost one branch.
class StageTimer final : public StageRecorder {
 public:
  explicit StageTimer(StageClock clock) : clock_(std::move(clock)) {}

  /// Times what follows, up to finish().
  void start(StageTimes::Kind kind);
  void begin(Stage stage) override;
  void end() override;
  /// With several iterations in a step, times are divided by their number.
  void finish(int n_iterations = 1);
  /// Discards the marks since start().
  void cancel() {
    open_.reset();
    stage_.reset();
  }

  /// Times that are known by now, oldest first; each is returned once. Does not wait.
  std::vector<StageTimes> take();
  /// Waits for the device; then all times that were not taken yet.
  std::vector<StageTimes> wait();

 private:
  using Mark = std::unique_ptr<StageMark>;
  struct Span {
    Stage stage;
    Mark from, to;
  };
  struct Record {
    StageTimes::Kind kind{};
    Mark from, to;
    std::vector<Span> spans;
    int n_iterations = 1;
  };
  static StageTimes read(const Record& record);

  StageClock clock_;
  std::deque<Record> finished_;
  std::optional<Record> open_;
  std::optional<Stage> stage_;
  Mark stage_from_;
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
  StageTimes steps_;  // sum
  double rounds_ms_ = 0;
  int n_timed_ = 0;
};

/// Splits the time of a session into training and output (evaluating and saving). Work on a GPU ends some time after
/// the call that queued it, so the device is waited for wherever one kind of work follows the other.
class TimeAccount {
 public:
  /// `clock_s` returns seconds; `wait_for_device` returns when the device has finished all queued work.
  TimeAccount(std::function<double()> clock_s, std::function<void()> wait_for_device)
      : clock_s_(std::move(clock_s)), wait_for_device_(std::move(wait_for_device)) {}

  /// What comes between the two counts as training. Does not wait for the device: work that is queued there is counted
  /// when a later piece of training waits for it.
  void begin_training() { start_s_ = clock_s_(); }
  void end_training() {
    train_s_ += clock_s_() - start_s_;
    is_idle_ = false;
  }
  template <class Work>
  void train(Work&& work) {
    begin_training();
    work();
    end_training();
  }

  /// Counts the duration of `work` as output, from when the device has finished training until it has finished `work`.
  template <class Work>
  void output(Work&& work) {
    finish_training();
    const double start_s = clock_s_();
    work();
    wait_for_device_();
    output_s_ += clock_s_() - start_s;
  }

  /// Waits until the device has finished training, and counts that as training.
  void finish_training() {
    if (is_idle_) return;
    train(wait_for_device_);
    is_idle_ = true;
  }

  double train_s() const { return train_s_; }
  double output_s() const { return output_s_; }

 private:
  std::function<double()> clock_s_;
  std::function<void()> wait_for_device_;
  double train_s_ = 0, output_s_ = 0;
  double start_s_ = 0;   // of the training that is being counted
  bool is_idle_ = true;  // the device
};

}  // namespace b3dgs
