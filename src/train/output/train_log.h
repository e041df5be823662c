// train.jsonl: one JSON object a line, for whoever plots a training.
#pragma once

#include <cstdint>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <utility>

#include "train/loss/metrics.h"
#include "train/timing/stage_timer.h"

namespace b3dgs {

struct TrainLogLine {
  int iteration = 0;
  double loss = 0;                           // running average
  double ms = 0;                             // per step, mean since the line before
  std::int64_t count = 0;                    // Gaussians
  double elapsed_s = 0;                      // of training, over all runs so far
  std::int64_t peak_memory_bytes = 0;        // of the process on the GPU, so far in this run; 0: not counted
  std::optional<StageTimes> stages;          // of the mean step, where some were timed since the line before
  std::string kernel, backward_kernel;       // in use; empty: there is no choice
  std::optional<ImageQuality> test_quality;  // mean over the test views, where they were evaluated
};

class TrainLog {
 public:
  /// Keeps the lines of `path` up to `iteration` (0 to begin anew) and appends to them. @throws IoError
  TrainLog(std::filesystem::path path, int iteration);
  ~TrainLog();
  TrainLog(const TrainLog&) = delete;
  TrainLog& operator=(const TrainLog&) = delete;

  /// The line is in the file when this returns, unless the system refuses it: then it waits for the next one.
  void write(const TrainLogLine& line);

  /// A line about something that happened: {"iteration", "event", and `fields`}.
  void write_event(int iteration, const char* event, const nlohmann::ordered_json& fields);

  /// Why lines are waiting, once each time that they begin to wait; else "".
  std::string take_fault() { return std::exchange(fault_, {}); }

 private:
  void append(const nlohmann::ordered_json& line);

  std::filesystem::path path_;
  int file_ = -1;
  std::string waiting_, fault_;
};

}  // namespace b3dgs
