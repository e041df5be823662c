// Callbacks and settings of a training for its caller.
#pragma once

#include <atomic>
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "raster/torch/rasterizer.h"
#include "scene/scene.h"
#include "train/memory/memory.h"
#include "train/output/train_recorder.h"
#include "train/poses/pose_refiner.h"
#include "train/timing/timers.h"

namespace b3dgs {

class Team;
struct Training;

/// The model between two steps, valid until TrainHooks::on_model returns.
struct ModelInTraining {
  int iteration = 0;
  const GaussianTensors& gaussians;
  const PoseState& poses;  // for with_refined_poses()
  int sh_degree = 0;       // optimised at present
  std::string kernel;      // forward kernel in use
};

struct TrainHooks : TrainListeners {
  ProgressFn on_loading;                          // progress of reading photographs before the first step
  const std::atomic<int>* stop_signal = nullptr;  // if nonzero, training writes a checkpoint and returns
  // Called after the files of the last iteration and before its density control, so the model is the one that was
  // saved. With several processes, only the first one calls it.
  std::function<void()> on_last_files_written;
  // For callers that show the model while it is trained. wants_model() is called after each step with its density
  // control, and if it returns true, on_model() is called. on_model() may read the model, call Trainer::save(), and
  // take its time, which counts as output time. It cannot affect the training. Not with several processes.
  std::function<bool()> wants_model;
  std::function<void(const ModelInTraining&)> on_model;
  // Creates the team of a training on several processes (multi/rank_team.h). Empty: this process trains alone.
  std::function<std::unique_ptr<Team>(Training&)> make_team;
  std::optional<double> gpu_memory_gb;  // overrides the option of this name, for processes that share a GPU

  // For tests and benchmarks.
  std::function<double()> clock_s;       // source of train_s and output_s; std::chrono::steady_clock if empty
  bool wait_for_files = false;           // waits until each file is on disk before the next iteration
  StageClock kernel_clock;               // for kernel checks; make_stage_clock() if empty
  std::shared_ptr<MemorySource> memory;  // make_memory_source() if null
  // Overrides image_cache_gb, in bytes of photographs that stay on the device, for trainers that share a device.
  std::optional<std::int64_t> image_budget;
};

}  // namespace b3dgs
