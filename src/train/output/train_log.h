// train.jsonl: one JSON object per line, for reports and plots.
#pragma once

#include <cstdint>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <utility>

#include "train/quality/metrics.h"
#include "train/timing/stage_timer.h"

namespace b3dgs {

struct TrainLogLine {
  int iteration = 0;
  double loss = 0;                           // running average
  double ms = 0;                             // per step, mean since the line before
  std::int64_t count = 0;                    // Gaussians
  double elapsed_s = 0;                      // of training, over all sessions
  std::int64_t peak_memory_bytes = 0;        // of this process on the GPU, in this session; 0 = not measured
  std::optional<StageTimes> stages;          // of the average step, if steps were timed since the line before
  std::string kernel, backward_kernel;       // in use; empty = there is no choice
  std::optional<ImageQuality> test_quality;  // mean over the test views, if they were evaluated
};

class TrainLog {
 public:
  /// Keeps the lines of `path` up to `iteration` (0 = starts a new log) and appends to them. @throws IoError
  TrainLog(std::filesystem::path path, int iteration);
  ~TrainLog();
  TrainLog(const TrainLog&) = delete;
  TrainLog& operator=(const TrainLog&) = delete;

  /// The line is in the file when this returns. If it cannot be written, it is kept and retried with the next line.
  void write(const TrainLogLine& line);

  /// Writes a line about an event: {"iteration", "event", and `fields`}.
  void write_event(int iteration, const char* event, const nlohmann::ordered_json& fields);

  /// Why lines could not be written; returned once each time that writing starts to fail, else "".
  std::string take_fault() { return std::exchange(fault_, {}); }

 private:
  void append(const nlohmann::ordered_json& line);

  std::filesystem::path path_;
  int file_ = -1;
  std::string waiting_, fault_;
};

}  // namespace b3dgs
