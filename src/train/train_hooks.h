// What a caller of a training may ask of it.
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

/// The model between two steps. Valid until TrainHooks::on_model returns.
struct ModelInTraining {
  int iteration = 0;
  const GaussianTensors& gaussians;
  const PoseState& poses;  // with_refined_poses()
  int sh_degree = 0;       // optimised so far
  std::string kernel;      // forward kernel in use
};

struct TrainHooks : TrainListeners {
  ProgressFn on_loading;                          // while photographs are read before the first step
  const std::atomic<int>* stop_signal = nullptr;  // nonzero: write a checkpoint and return
  // After the files of the last iteration and before its density control: the model is the one that was saved. Of
  // several processes, in the first one.
  std::function<void()> on_result;
  // For callers that show the model while it is trained: after each step with its density control, wants_model() is
  // asked, and on_model() called if it returns true. It may read the model, call Trainer::save(), and take
  // its time, which counts as output; whatever it does, the training stays the same. Not with several processes.
  std::function<bool()> wants_model;
  std::function<void(const ModelInTraining&)> on_model;
  // Makes the team of a training on several processes (multi/rank_team.h). Empty: this process trains alone.
  std::function<std::unique_ptr<Team>(Training&)> make_team;
  std::optional<double> gpu_memory_gb;  // overrides the option, for processes that share a GPU

  // For tests and benchmarks.
  std::function<double()> clock_s;       // seconds for train_s and output_s; std::chrono::steady_clock if empty
  bool wait_for_files = false;           // each file is on disk before the next iteration
  StageClock kernel_clock;               // for kernel checks; the device's if empty
  std::shared_ptr<MemorySource> memory;  // the device's if null
  // Bytes of photographs that stay on the device, overriding image_cache_gb, for trainers that share a device.
  std::optional<std::int64_t> image_budget;
};

}  // namespace b3dgs
