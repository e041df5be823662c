// Shared by the parts of a training. A Trainer owns it, and it outlives everything that refers to it.
#pragma once

#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "config/train_config.h"
#include "model/model_folder.h"
#include "raster/torch/rasterizer.h"
#include "scene/scene.h"
#include "train/checkpoint/train_state.h"
#include "train/density/density_strategy.h"
#include "train/density/row_edit.h"
#include "train/final_config.h"
#include "train/gaussians/smoothing_filter.h"
#include "train/memory/memory.h"
#include "train/objective.h"
#include "train/optimizer/gaussian_optimizer.h"
#include "train/output/train_recorder.h"
#include "train/selection/kernel_check.h"
#include "train/timing/timers.h"
#include "train/train_hooks.h"
#include "train/training_views.h"

namespace b3dgs {

struct Training {
  /// @throws InputError as Trainer does
  Training(const FinalConfig& final_config, const Scene& scene, ModelFolder folder, TrainHooks hooks);

  /// Whether the user has asked for an end.
  bool is_stopped() const { return hooks.stop_signal != nullptr && hooks.stop_signal->load() != 0; }

  /// How to continue from a checkpoint.
  std::string resume_words(const std::filesystem::path& checkpoint) const;
  /// "; last checkpoint: PATH", to be appended to an error.
  std::string last_checkpoint() const;

  /// Makes the appearance state, unless that of a checkpoint fits; drops it if no option asks for it.
  void prepare_appearance();
  /// With --antialiasing, computes the filters of the Gaussians if that is due or rows have changed. All processes call
  /// it together.
  void update_filters(bool is_due);
  /// Applies the deferred optimizer updates, which is part of training.
  void flush() {
    if (state.gaussians.size() > 0) optimizer.flush(state.gaussians, state.adam);
  }
  /// The state without deferred updates, and with filters for anti-aliasing.
  TrainState& flushed_state() {
    flush();
    update_filters(/*is_due=*/false);
    return state;
  }

  // Remedies for a lack of memory.
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
  /// The device for tensors of the whole model. With several processes this is the CPU, because the model may not fit
  /// on one GPU.
  const torch::Device whole_device;
  const std::shared_ptr<MemorySource> memory;
  Rasterizer rasterizer;
  GaussianOptimizer optimizer;
  RowEditor row_editor;
  Objective objective;
  const std::unique_ptr<DensityStrategy> density;
  KernelCheck kernels;
  TrainState state;  // use flushed_state() to read SH coefficients beyond degree 0 or their Adam moments
  TrainingViews views;
  EmptyViews empty_views;
  CameraView largest_view{};                         // memory is planned for it
  std::int64_t view_bytes = 0;                       // of the rasterizer's buffers after the last view
  std::optional<SmoothingFilter> smoothing_filter;   // with --antialiasing
  SmoothingFilter::FindLargest find_largest_filter;  // of several processes
  StageTimer timer;
  TimeAccount time;
  TrainRecorder recorder;
  nlohmann::ordered_json fingerprint;  // of the scene, for checkpoints; null until the first step
  bool is_consistent = true;           // `state`; false while, or after, a change to it was interrupted halfway
};

/// Identifies the scene in a checkpoint.
nlohmann::ordered_json scene_identity(const Training& training);

}  // namespace b3dgs
