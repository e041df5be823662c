// What a training tells its caller: progress and messages while it runs, its outputs and times at the end.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include "model/model_folder.h"
#include "train/timing/timers.h"

namespace b3dgs {

struct TrainProgress {
  int iteration = 0, iterations = 0;
  double loss = 0;  // running average, 0.4 x new + 0.6 x old as the original 3DGS prints it
  std::int64_t n_gaussians = 0;
  std::int64_t held_at = 0;  // the count is held here for lack of GPU memory; 0 = not held
  double elapsed_s = 0;      // of training in this session, without evaluation and saving
  // "training", "checking kernels", "densifying", "timing kernels", "evaluating", "saving", "checkpoint",
  // "counting floaters"
  std::string activity;
};

/// Callbacks; any may be empty.
struct TrainListeners {
  std::function<void(const TrainProgress&)> on_progress;  // after each step and before each longer activity
  std::function<void(const std::string&)> on_message;     // one line for the user
  std::function<void(const std::string&)> on_warning;     // one line: something is wrong, but training continues
  std::function<void(int iteration, const Evaluation&)> on_evaluation;  // of the test views
  // If set, every step is timed stage by stage, and reported some time after the device has finished it.
  std::function<void(const StageTimes&)> on_stage_times;
  std::string resume_command;  // named by errors that a training can be resumed after; empty: the option --resume
};

/// Files and evaluations of this session.
struct TrainOutputs {
  std::filesystem::path ply, checkpoint;  // last ones written
  std::int64_t n_saved = 0;  // Gaussians in the last PLY; density control of the last iteration comes after it
  std::vector<std::filesystem::path> not_written;       // the system refused, e.g. because the disk is full
  std::vector<std::pair<int, Evaluation>> evaluations;  // of the test views, by iteration
};

struct TrainResult : TrainOutputs {
  int first_iteration = 0;   // last one done before this session
  int iteration = 0;         // last one done
  bool interrupted = false;  // by stop_signal
  std::int64_t n_gaussians = 0;
  std::int64_t peak_memory_bytes = 0;  // of this process on the GPU, without the CUDA context; 0 = not measured
  double train_s = 0;                  // uploads, kernel checks, steps, density control; without reading of files
  double output_s = 0;                 // evaluation, statistics, saving, checkpoints
  std::int64_t n_removed = 0;          // invalid Gaussians that were removed, over all sessions
};

}  // namespace b3dgs
