// Records a training. It writes train.jsonl, evaluations, PLYs and checkpoints, and reports progress and messages
// during the training and its outputs and times at the end. It reads the state of the training and never changes it.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "config/train_config.h"
#include "core/check.h"
#include "model/model_folder.h"
#include "train/checkpoint/train_state.h"
#include "train/memory/memory.h"
#include "train/output/output_writer.h"
#include "train/quality/metrics.h"
#include "train/timing/timers.h"

namespace b3dgs {

struct TrainProgress {
  int iteration = 0, iterations = 0;
  double loss = 0;  // running average, 0.4 x new + 0.6 x old as the original 3DGS prints it
  std::int64_t n_gaussians = 0;
  std::int64_t count_cap = 0;  // cap on the number of Gaussians for lack of GPU memory; 0: none
  double elapsed_s = 0;        // training time in this session, without evaluation and saving
  // "training", "densifying", "evaluating", "saving", "checkpoint" or "counting floaters"
  std::string activity;
};

/// Callbacks, which may be empty.
struct TrainListeners {
  std::function<void(const TrainProgress&)> on_progress;  // after each step and before each longer activity
  std::function<void(const std::string&)> on_message;     // one line for the user
  std::function<void(const std::string&)> on_warning;     // one line about a problem that does not end the training
  std::function<void(int iteration, const Evaluation&)> on_evaluation;  // evaluation of the test views
  // If this is set, every step is timed, and the times of its stages are reported some time after the device has
  // finished it.
  std::function<void(const StageTimes&)> on_stage_times;
  std::string resume_command;  // named in errors after which training can be resumed; empty: the option --resume
};

/// Files and evaluations of this session.
struct TrainOutputs {
  std::filesystem::path ply, checkpoint;  // last files written
  std::int64_t n_saved = 0;  // Gaussians in the last PLY, which precedes the density control of the same iteration
  // Files that the system refused to write, for example because the disk is full.
  std::vector<std::filesystem::path> not_written;
  std::vector<std::pair<int, Evaluation>> evaluations;  // of the test views, by iteration
};

struct TrainResult : TrainOutputs {
  int first_iteration = 0;   // last iteration before this session
  int iteration = 0;         // last completed iteration
  bool interrupted = false;  // by stop_signal
  std::int64_t n_gaussians = 0;
  std::int64_t peak_memory_bytes = 0;  // GPU memory of this process without the CUDA context; 0: not measured
  double train_s = 0;                  // uploads, kernel checks, steps and density control, without reading files
  double output_s = 0;                 // evaluation, statistics, PLYs and checkpoints
  std::int64_t n_removed = 0;          // invalid Gaussians removed in all sessions
};

/// Writes train.jsonl, which has one JSON object per line, for reports and plots.
class TrainLog {
 public:
  /// Keeps the lines of `path` up to `iteration` (0 starts a new log) and appends to them. @throws IoError
  TrainLog(std::filesystem::path path, int iteration);
  ~TrainLog();
  TrainLog(const TrainLog&) = delete;
  TrainLog& operator=(const TrainLog&) = delete;

  /// Writes a line, which is in the file when this returns. If it cannot be written, it is kept and written with the
  /// next one.
  void write(const nlohmann::ordered_json& line);

  /// Returns why lines could not be written, once each time that writing starts to fail, and otherwise "".
  std::string take_fault() { return std::exchange(fault_, {}); }

 private:
  std::filesystem::path path_;
  int file_ = -1;
  std::string waiting_, fault_;
};

class TrainRecorder {
 public:
  /// The objects that are recorded. All of them must outlive the recorder.
  struct Source {
    const TrainConfig& config;
    const ModelFolder& folder;
    const TrainListeners& listeners;
    const TrainState& state;
    const TimeAccount& time;
    MemorySource& memory;
    StageTimer& timer;
    const CoordinateFrame& frame;  // frame of the Gaussians
  };

  TrainRecorder(const Source& source, torch::Device device) : source_(source), writer_(device) {}

  /// Sets the checkpoint that the training continues from, after `elapsed_s` seconds of training.
  void resume_from(const std::filesystem::path& checkpoint, double elapsed_s) {
    outputs_.checkpoint = checkpoint;
    resumed_s_ = elapsed_s;
  }

  // Messages and progress.
  void report_progress(const char* activity) const;
  void say(const std::string& message) const;
  void warn(const std::string& message) const;
  /// Calls write(). An IoError becomes a warning.
  template <class Write>
  void try_to_write(Write&& write) const {
    try {
      write();
    } catch (const IoError& error) {
      warn(error.what());
    }
  }

  // train.jsonl. Events before open_log() are dropped.
  void open_log();
  /// Writes a line about an event: {"iteration", "event", and `fields`}.
  void log_event(int iteration, const char* event, const nlohmann::ordered_json& fields);
  /// Writes the line of this iteration. `kernel` is the current kernel.
  void log_iteration(const std::optional<ImageQuality>& test_quality, const std::string& kernel);
  /// Writes the results files, and reports a message. `source` describes the evaluated views.
  void add_evaluation(const Evaluation& evaluation, const EvaluationSource& source);

  // Times.
  /// Returns the training time over all sessions in s.
  double elapsed_s() const { return resumed_s_ + source_.time.train_s(); }
  /// Passes stage times that are known by now to the log and the listener.
  void collect_stage_times() { add_stage_times(source_.timer.take()); }
  void wait_for_stage_times() { add_stage_times(source_.timer.wait()); }

  // PLYs and checkpoints are written in the background. At the end of the training, that is after the last iteration or
  // between set_ending(true) and set_ending(false), a file is on disk when its call returns.
  void set_ending(bool is_ending) { is_ending_ = is_ending; }
  void write_ply(const GaussianTensors& gaussians);
  /// Records that the last PLY is that of this iteration, written by an earlier session.
  void use_existing_ply() { outputs_.ply = source_.folder.ply(source_.state.iteration); }
  /// Writes a checkpoint. Both arguments must come from the state without deferred updates, with its elapsed time set.
  void write_checkpoint(const nlohmann::ordered_json& header, const std::vector<CheckpointTensor>& tensors);
  /// Returns whether --checkpoint_minutes have passed since the last checkpoint and no file is being written.
  bool is_checkpoint_due() const;
  bool is_writing() const { return writer_.is_busy(); }
  void wait_for_files() { writer_.wait(); }
  /// Handles the files that have been written, or could not be, since the last call. Warns about failures, and removes
  /// superseded checkpoints.
  void collect_files();
  /// Waits for all files. @throws IoError if a file of the last iteration could not be written
  void finish_files();
  /// Returns the files of the last iteration that could not be written.
  const std::vector<WrittenFile>& failed_files() const { return failed_; }
  /// @throws IoError if one of them is a checkpoint, and removes it from the list
  void require_checkpoint();
  const TrainOutputs& outputs() const { return outputs_; }
  /// Returns "; last checkpoint: PATH", to append to an error message.
  std::string last_checkpoint() const;

 private:
  bool is_complete() const { return source_.state.iteration == source_.config.iterations; }
  bool is_end() const { return is_complete() || is_ending_; }
  /// Returns the file of this iteration.
  WrittenFile new_file(WrittenFile::Kind kind) const;
  /// At the end of the training, waits for the file that is being written.
  void wait_at_end();
  void handle(const WrittenFile& file);
  /// Returns the end of an error message if the last files could not be written: which files exist, and how to
  /// continue.
  std::string remedy() const;
  /// Returns whether tensors of this size should be copied on the device, to be written in the background.
  bool has_room_for_copy(std::int64_t bytes) const;
  void add_stage_times(const std::vector<StageTimes>& known);

  const Source source_;
  OutputWriter writer_;
  TrainOutputs outputs_;
  std::vector<WrittenFile> failed_;
  std::unique_ptr<TrainLog> log_;
  StageAverage stages_;
  bool is_ending_ = false;
  double resumed_s_ = 0;      // training time before this session
  double checkpoint_s_ = 0;   // time.train_s() at the last checkpoint
  int logged_iteration_ = 0;  // iteration of the last log line
  double logged_s_ = 0;       // time.train_s() at that line
  double logged_ms_ = 0;      // mean time of an iteration before that line; 0: no line in this session
  int staged_iteration_ = 0;  // iteration of the last line with stage times
};

}  // namespace b3dgs
