// Trains a model, from the start or a checkpoint to its end or a failure: takes the steps and does what is due between
// them, and writes what the user gets. The public interface.
//
//   trainer.cpp          the loop, and what happens when it fails
//   trainer_outputs.cpp  the start of a session, and what an iteration evaluates, logs and saves
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "config/train_config.h"
#include "core/files/own_files.h"
#include "model/model_folder.h"
#include "scene/scene.h"
#include "train/evaluate.h"
#include "train/final_config.h"
#include "train/memory_plan.h"
#include "train/train_hooks.h"

namespace b3dgs {

class DensityControl;
class StepRecovery;
class Team;
struct OutputPlan;
struct Training;

class Trainer {
 public:
  /// `scene` must outlive the trainer. @throws InputError
  Trainer(const FinalConfig& config, const Scene& scene, ModelFolder folder, TrainHooks hooks);
  ~Trainer();

  /// Resumes from a checkpoint. Returns the options that differ from it, as "name: old -> new".
  /// @throws InputError if the file is damaged or does not belong to this scene
  std::vector<std::string> resume(const std::filesystem::path& checkpoint);

  /// Runs to config.iterations (or the stop signal), writing the folder's files on the way. Gaussians that cannot be
  /// rendered are removed; files that cannot be written on the way cause a warning; training continues in both cases.
  /// After a stop signal, the model is left as a checkpoint and a PLY.
  /// An error that ends training leaves a checkpoint of the last complete iteration and names it. If the loss is not
  /// finite, the model may be damaged: no checkpoint is written, and the error names the last one before.
  /// @throws InputError if the folder holds the model of another training, or a photograph cannot be read; IoError if
  /// the last files cannot be written; NumericError with iteration and view; OutOfMemoryError
  /// With `until` (at most config.iterations), returns after that iteration; call it again to continue. The result is
  /// the same as that of a single run(). The device has finished when this returns, so that trainers can take turns
  /// without affecting each other's times.
  TrainResult run(std::optional<int> until = std::nullopt);

  /// Last iteration done.
  int iteration() const { return state_.iteration; }

  /// Renders `views` with the current model and computes their PSNR and SSIM; training views with their refined poses.
  /// Call run() first. Of several processes, all call this together, except in TrainHooks::on_result; the result
  /// is in the first one.
  Evaluation evaluate(const std::vector<View>& views, const RenderedFn& on_rendered = {});

  /// Writes a checkpoint of the current state and waits for it. Call run() first. @throws IoError
  std::filesystem::path write_checkpoint();

  /// The same, and writes the PLY of this iteration, for viewers, unless there is one. A PLY that cannot be written
  /// causes a warning. Returns the checkpoint. Not with several processes.
  std::filesystem::path save();

  /// One iteration with its density control, without any output. For benchmarks.
  void step();

  /// Waits until the device has finished all steps, and reports the remaining stage times.
  void wait();

  /// Where the photographs are stored, on one line: "for training 80 in memory (122.9 MB); for testing none".
  std::string describe_images() const;

  std::int64_t n_gaussians() const { return state_.n_gaussians(); }
  int sh_degree() const { return state_.sh_degree; }  // currently optimised

  /// GPU memory that training is going to use; nothing on a CPU. Makes the initial Gaussians unless there are some.
  std::optional<MemoryForecast> forecast_memory();

 private:
  // trainer.cpp
  /// Makes the initial Gaussians unless there are some.
  void ensure_model();
  /// One step and everything that is due after it.
  void run_iteration();
  void show_model();
  /// Writes a checkpoint if the state is consistent, and throws `cause` with the checkpoint's path.
  [[noreturn]] void end_with_checkpoint(const std::exception& cause);
  /// The end of the error message: where training can be resumed.
  std::string save_last_state();

  // trainer_outputs.cpp
  /// Prepares the first step of this session. Does nothing when called again.
  void begin();
  /// Marks the folder as the one of this training, and sets aside what it holds of later iterations.
  void claim_folder();
  void warn_of_disk_space();
  /// Calls work() in the first process.
  void render_on_first(const std::function<void(const RenderModelFn&)>& work);
  void write_outputs(const OutputPlan& plan);
  void log_load(const RenderModelFn& render);
  void log_floaters();
  Evaluation evaluate_with(const RenderModelFn& render, const std::vector<View>& views, const RenderedFn& on_rendered);
  void write_ply();
  /// cameras.json and poses.json, with the refined poses.
  void write_poses();
  void write_state();

  const std::unique_ptr<Training> training_;
  const TrainConfig& config_;  // these are of training_
  const Scene& scene_;
  TrainState& state_;
  TimeAccount& time_;
  TrainRecorder& recorder_;
  std::unique_ptr<Team> team_;
  std::unique_ptr<StepRecovery> steps_;
  std::unique_ptr<DensityControl> density_control_;
  std::unique_ptr<OwnFiles> own_files_;  // of the folder, while it is written
  TrainResult result_;
  bool has_begun_ = false;
  std::filesystem::path resumed_;             // checkpoint
  std::vector<std::string> changed_options_;  // since that checkpoint was written
};

}  // namespace b3dgs
