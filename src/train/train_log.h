// train.jsonl: one JSON object a line, for whoever plots a training.
#pragma once

#include <cstdint>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>

#include "train/metrics.h"
#include "train/stage_timer.h"

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

  /// The line is in the file when this returns. @throws IoError
  void write(const TrainLogLine& line);

  /// A line about something that happened: {"iteration", "event", and `fields`}. @throws IoError
  void write_event(int iteration, const char* event, const nlohmann::ordered_json& fields);

 private:
  void append(const nlohmann::ordered_json& line);

  std::filesystem::path path_;
  std::ofstream file_;
};

}  // namespace b3dgs
