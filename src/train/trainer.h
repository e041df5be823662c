// The public interface of training. A Trainer trains a model from the start or from a checkpoint. It takes the steps,
// does the work that is due between them, and writes all output files.
//
//   trainer.cpp          the training loop, and the handling of failures
//   trainer_outputs.cpp  the start of a session, and evaluation, logging and saving
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
class StepRunner;
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

  /// Trains to config.iterations, or until the stop signal, and writes the files of the model folder on the way.
  /// Training continues if Gaussians cannot be rendered, which are removed, and if a file cannot be written on the way,
  /// which causes a warning. After a stop signal, it writes a checkpoint and a PLY.
  /// If an error ends the training, the last complete iteration is saved as a checkpoint and the error names it. If the
  /// loss is not finite, the model may be damaged. Then no checkpoint is written, and the error names the last one
  /// before.
  /// With `until` (at most config.iterations), returns after that iteration. Call it again to continue. The result is
  /// the same as that of a single run(). The device is idle when this returns, so that trainers can take turns without
  /// affecting each other's times.
  /// @throws InputError if the folder contains the model of another training, or a photograph cannot be read
  /// @throws IoError if the last files cannot be written
  /// @throws NumericError with iteration and view
  /// @throws OutOfMemoryError
  TrainResult run(std::optional<int> until = std::nullopt);

  /// Returns the last completed iteration.
  int iteration() const { return state_.iteration; }

  /// Renders `views` with the current model and computes their PSNR and SSIM. Training views have their refined poses.
  /// Call run() first. With several processes, all call this together, except in TrainHooks::on_last_files_written, and
  /// the first one gets the result.
  Evaluation evaluate(const std::vector<View>& views, const RenderedFn& on_rendered = {});

  /// Writes a checkpoint of the current state, waits for it and returns its path. Call run() first. @throws IoError
  std::filesystem::path write_checkpoint();

  /// Does the same, and also writes the PLY of this iteration unless it exists. If the PLY cannot be written, this
  /// causes a warning only. Returns the path of the checkpoint. Not with several processes. @throws IoError
  std::filesystem::path save();

  /// Takes one step with its density control, without any output. For benchmarks.
  void step();

  /// Waits until the device has finished all steps, and reports the remaining stage times.
  void wait();

  /// Returns where the photographs are stored, on one line: "for training 80 in memory (122.9 MB); for testing none".
  std::string describe_images() const;

  std::int64_t n_gaussians() const { return state_.n_gaussians(); }
  int sh_degree() const { return state_.sh_degree; }  // optimised at present

  /// Returns the forecast of the GPU memory, or nothing on a CPU. Creates the initial Gaussians if there are none yet.
  std::optional<MemoryForecast> forecast_memory();

 private:
  // trainer.cpp
  /// Creates the initial Gaussians if there are none yet.
  void ensure_model();
  /// Takes one step, and does everything that is due after it.
  void run_iteration();
  /// Calls TrainHooks::on_model with the current model.
  void show_model();
  /// Writes a checkpoint if the state is consistent, and throws `cause` with the checkpoint's path.
  [[noreturn]] void end_with_checkpoint(const std::exception& cause);
  /// Writes a checkpoint if the state is consistent. Returns the end of an error message, which says where training can
  /// be resumed.
  std::string save_last_state();

  // trainer_outputs.cpp
  /// Prepares the first step of this session. Does nothing when called again.
  void begin();
  /// Marks the folder as that of this training, and moves files of later iterations aside.
  void mark_folder();
  void warn_of_disk_space();
  /// Reads back the losses, then calls work() in the first process.
  void render_on_first(const std::function<void(const RenderModelFn&)>& work);
  void write_outputs(const OutputPlan& plan);
  void log_load(const RenderModelFn& render);
  void log_floaters();
  Evaluation evaluate_with(const RenderModelFn& render, const std::vector<View>& views, const RenderedFn& on_rendered);
  void write_ply();
  /// Writes cameras.json and poses.json with the refined poses, if there are any.
  void write_poses();
  void write_state();

  const std::unique_ptr<Training> training_;
  // Members of training_.
  const TrainConfig& config_;
  const Scene& scene_;
  TrainState& state_;
  TimeAccount& time_;
  TrainRecorder& recorder_;
  std::unique_ptr<Team> team_;
  std::unique_ptr<StepRunner> step_runner_;
  std::unique_ptr<DensityControl> density_control_;
  std::unique_ptr<OwnFiles> own_files_;  // marks the folder as in use
  TrainResult result_;
  bool has_begun_ = false;
  std::filesystem::path resumed_;             // path of the checkpoint
  std::vector<std::string> changed_options_;  // compared with that checkpoint
};

}  // namespace b3dgs
