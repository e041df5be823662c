// Timing of a training: the stages of its steps, and the split between training and output.
//
// A GPU works asynchronously, so a host clock around a call measures only the queueing.
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

/// A time mark in a device's queue of work.
class StageMark {
 public:
  virtual ~StageMark() = default;
  /// Returns whether the device has reached the mark.
  virtual bool is_reached() const = 0;
  virtual void wait() const = 0;
  /// Returns the milliseconds since an earlier mark of the same clock. Both must have been reached.
  virtual double ms_since(const StageMark& from) const = 0;
};

/// Places a mark at the end of the queue. Asynchronous.
using StageClock = std::function<std::unique_ptr<StageMark>()>;

/// Returns a clock of CUDA events on LibTorch's current stream for a GPU, and std::chrono::steady_clock for the CPU.
StageClock make_stage_clock(torch::Device device);

/// Duration of a step or of a round of density control, and of its stages.
struct StageTimes {
  enum class Kind { kStep, kDensityRound };

  Kind kind = Kind::kStep;
  std::array<std::optional<double>, kStageCount> ms{};  // empty for stages that did not take place
  double wall_ms = 0;                                   // from start to end

  /// Adds `share` times the other times.
  void add(const StageTimes& others, double share);
  /// Returns the wall-clock time that belongs to no stage, in which the device waited for the host.
  double host_ms() const;
};

/// Returns {"project": 0.1, ..., "host": 0.05} with the stages that took place, by name (raster/stages.h), in ms.
nlohmann::ordered_json stage_json(const StageTimes& times);

/// Times the stages of a step on the device without slowing it down. Marks are queued with the work, and read while a
/// later step is running. Outside of a timed step, begin() and end() cost one branch.
class StageTimer final : public StageRecorder {
 public:
  explicit StageTimer(StageClock clock) : clock_(std::move(clock)) {}

  /// Starts timing, until finish().
  void start(StageTimes::Kind kind);
  void begin(Stage stage) override;
  void end() override;
  /// Ends timing. All times are divided by the number of iterations in the step.
  void finish(int n_iterations = 1);
  /// Discards the marks since start().
  void cancel() {
    open_.reset();
    stage_.reset();
  }

  /// Returns the times that are known by now, oldest first, each of them once. Does not wait.
  std::vector<StageTimes> take();
  /// Waits for the device, and returns all times that take() has not returned yet.
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

/// Averages steps between two log lines. Only some steps are timed, but all rounds of density control are, because they
/// are rare. The time of the rounds is averaged over all steps.
class StageAverage {
 public:
  void add(const StageTimes& times);
  /// Returns the average over the `n_steps` since take() last returned one. If no step has been timed since then,
  /// returns nothing and keeps the times added so far.
  std::optional<StageTimes> take(int n_steps);

 private:
  StageTimes steps_;  // sum of the timed steps
  double rounds_ms_ = 0;
  int n_timed_ = 0;
};

/// Splits the time of a session into training and output (evaluating and saving). Work on a GPU ends some time after
/// the call that queued it, so this waits for the device wherever one kind of work follows the other.
class TimeAccount {
 public:
  /// `clock_s` returns the time in seconds. `wait_for_device` returns when the device has finished all queued work.
  TimeAccount(std::function<double()> clock_s, std::function<void()> wait_for_device)
      : clock_s_(std::move(clock_s)), wait_for_device_(std::move(wait_for_device)) {}

  /// Time between the two calls counts as training. They do not wait for the device. Work that is still queued there is
  /// counted when a later part of training waits for it.
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

  /// Calls work() and counts its duration as output, from the moment when the device has finished training until it has
  /// finished the work.
  template <class Work>
  void output(Work&& work) {
    finish_training();
    const double start_s = clock_s_();
    work();
    wait_for_device_();
    output_s_ += clock_s_() - start_s;
  }

  /// Waits until the device has finished training. The waiting time counts as training.
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
  double start_s_ = 0;   // start of the training that is being counted
  bool is_idle_ = true;  // true if the device has no training work queued
};

}  // namespace b3dgs
