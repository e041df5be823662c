// State and services shared by the parts of a training. A Trainer owns it, and it outlives everything that refers to
// it.
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

  /// Returns whether the stop signal is set.
  bool is_stopped() const { return hooks.stop_signal != nullptr && hooks.stop_signal->load() != 0; }

  /// Returns the advice how to continue from a checkpoint: "continue with --resume PATH".
  std::string resume_words(const std::filesystem::path& checkpoint) const;
  /// Returns "; last checkpoint: PATH", to append to an error message.
  std::string last_checkpoint() const;

  /// Creates the appearance state unless that of a checkpoint fits. Drops it if no option needs it.
  void prepare_appearance();
  /// With --antialiasing, computes the 3D filters of the Gaussians if an update is due or Gaussians were added or
  /// removed. All processes call it together.
  void update_filters(bool is_due);
  /// Applies the deferred optimizer updates. Its time counts as training.
  void flush() {
    if (state.gaussians.size() > 0) optimizer.flush(state.gaussians, state.adam);
  }
  /// Returns the state without deferred updates, and with filters for anti-aliasing.
  TrainState& flushed_state() {
    flush();
    update_filters(/*is_due=*/false);
    return state;
  }

  // Remedies for a lack of memory, in the order in which they are tried.
  MemoryRemedy waiting_for_files();
  MemoryRemedy freeing_scratch();
  MemoryRemedy releasing_photographs();
  std::vector<MemoryRemedy> remedies() { return {waiting_for_files(), freeing_scratch(), releasing_photographs()}; }
  /// Returns cached memory to the device if the allocator caches more than a certain share.
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
  CameraView largest_view{};                         // memory is planned for this view
  std::int64_t view_bytes = 0;                       // size of the rasterizer's buffers after the last view
  std::optional<SmoothingFilter> smoothing_filter;   // with --antialiasing
  SmoothingFilter::FindLargest find_largest_filter;  // with several processes only
  StageTimer timer;
  TimeAccount time;
  TrainRecorder recorder;
  nlohmann::ordered_json fingerprint;  // identifies the scene in checkpoints; null until the first step or resume()
  bool is_consistent = true;           // false while `state` is being changed, and after a change that failed halfway
};

/// Returns the data that identify the scene, and with --depths the depth maps, in a checkpoint.
nlohmann::ordered_json scene_identity(const Training& training);

}  // namespace b3dgs
