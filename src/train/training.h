// What the parts of a training share. A Trainer owns it, and it outlives everything that refers to it.
#pragma once

#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "config/train_config.h"
#include "model/model_folder.h"
#include "raster/torch/rasterizer.h"
#include "scene/scene.h"
#include "train/checkpoint/train_state.h"
#include "train/density/density_strategy.h"
#include "train/memory/memory.h"
#include "train/objective.h"
#include "train/output/train_recorder.h"
#include "train/selection/kernel_check.h"
#include "train/timing/timers.h"
#include "train/train_hooks.h"
#include "train/training_views.h"

namespace b3dgs {

struct Training {
  /// `config.device` is "cpu" or "cuda". @throws InputError as Trainer does
  Training(const TrainConfig& config, const Scene& scene, ModelFolder folder, TrainHooks hooks);

  /// Whether the user has asked for an end.
  bool is_stopped() const { return hooks.stop_signal != nullptr && hooks.stop_signal->load() != 0; }

  /// How to continue from a checkpoint.
  std::string resume_words(const std::filesystem::path& checkpoint) const;

  // What can be done when memory is short.
  MemoryRemedy wait_for_files();
  MemoryRemedy free_scratch();
  MemoryRemedy release_photographs();
  std::vector<MemoryRemedy> remedies() { return {wait_for_files(), free_scratch(), release_photographs()}; }
  /// Returns memory that the allocator caches beyond a share.
  void trim_memory() {
    if (keeps_too_much(memory->use())) memory->release_unused();
  }

  const TrainConfig config;
  const Scene& scene;
  const ModelFolder folder;
  const TrainHooks hooks;
  const torch::Device device;
  const std::shared_ptr<MemorySource> memory;
  Rasterizer rasterizer;
  Objective objective;
  const std::unique_ptr<DensityStrategy> density;
  KernelCheck kernels;
  TrainState state;  // use Stepper::flushed_state() to read SH coefficients beyond degree 0 or their Adam moments
  TrainingViews views;
  StageTimer timer;
  TimeAccount time;
  TrainRecorder recorder;
  nlohmann::ordered_json fingerprint;  // of the scene, for checkpoints; null until the first step
  bool is_consistent = true;           // `state`; false while, or after, a change to it was interrupted halfway
};

/// What a checkpoint says about the scene.
nlohmann::ordered_json scene_identity(const Training& training);

}  // namespace b3dgs
