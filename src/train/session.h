// A session of a training, from the start or a checkpoint to its end or a failure: it takes the steps and does what is
// due between them, and writes what the user gets.
//
//   session.cpp          the loop, and what happens when it fails
//   session_outputs.cpp  start of a session, and what an iteration evaluates, logs and saves
#pragma once

#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "config/output_plan.h"
#include "core/files/own_files.h"
#include "train/density_control.h"
#include "train/stepper.h"
#include "train/trainer.h"
#include "train/training.h"

namespace b3dgs {

class Session {
 public:
  /// `config.device` is "cpu" or "cuda".
  Session(const TrainConfig& config, const Scene& scene, ModelFolder folder, TrainHooks hooks);

  // As in Trainer.
  std::vector<std::string> resume(const std::filesystem::path& checkpoint);
  TrainResult run_until(int iteration);
  Evaluation evaluate(const std::vector<View>& views, const RenderedFn& on_rendered);
  std::filesystem::path write_checkpoint();
  std::filesystem::path save();
  void step();
  void wait();
  std::optional<MemoryForecast> forecast_memory();
  std::string describe_images() const;
  const TrainState& state() const { return training_.state; }
  int iterations() const { return training_.config.iterations; }

 private:
  // session.cpp
  void initialize_model();
  /// One step and everything that is due after it. @throws what failed, with the path of the checkpoint written
  /// appended
  void iterate();
  void run_iteration();
  /// Times the blending kernels before the next step, if that is due. Does not change the Gaussians.
  void check_kernels();
  void show_model();
  /// Writes a checkpoint if the state is consistent, and rethrows the current exception with the checkpoint's path.
  [[noreturn]] void end_with_checkpoint();
  /// The end of the error message: where training can be resumed.
  std::string save_last_state();
  std::string last_checkpoint() const;
  /// How to continue from a checkpoint.
  std::string resume_words(const std::filesystem::path& checkpoint) const;

  // session_outputs.cpp
  /// Prepares the first step of this session. Does nothing when called again.
  void begin();
  /// What a checkpoint says about the scene.
  nlohmann::ordered_json identify_scene() const;
  /// Marks the folder as the one of this training, and sets aside what it holds of later iterations.
  void claim_folder();
  void warn_of_disk_space();
  void write_outputs(const OutputPlan& plan);
  void log_load();
  void log_kernel_times();
  void log_floaters();
  /// No value if no test view has a valid pixel.
  std::optional<ImageQuality> evaluate_test_views();
  Evaluation evaluate_here(const std::vector<View>& views, const RenderedFn& on_rendered);
  /// The next views, and the current model.
  BlendInput kernel_check_input();
  void write_ply();
  /// cameras.json and poses.json, with the refined poses.
  void write_poses();
  void write_state();

  Training training_;
  const std::unique_ptr<Stepper> stepper_;
  DensityControl density_control_;
  std::optional<OwnFiles> own_files_;  // of the folder, while it is written
  TrainResult result_;
  bool has_begun_ = false;
  std::filesystem::path resumed_;             // checkpoint
  std::vector<std::string> changed_options_;  // since that checkpoint was written
  nlohmann::ordered_json fingerprint_;        // of the scene
};

}  // namespace b3dgs
