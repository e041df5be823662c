// What a training holds, shared by the sources of the trainer: trainer.cpp (its life), trainer_step.cpp (a step) and
// trainer_outputs.cpp (what is measured and saved).
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "core/check.h"
#include "raster/math/invalid_gaussian.h"
#include "scene/view_image.h"
#include "train/checkpoint/train_state.h"
#include "train/config/output_plan.h"
#include "train/density/row_edit.h"
#include "train/device.h"
#include "train/images/image_store.h"
#include "train/loss/loss.h"
#include "train/memory/memory_plan.h"
#include "train/memory/memory_source.h"
#include "train/optimizer/gaussian_step.h"
#include "train/output/output_writer.h"
#include "train/output/train_log.h"
#include "train/selection/kernel_chooser.h"
#include "train/timing/stage_timer.h"
#include "train/timing/time_account.h"
#include "train/trainer.h"

namespace b3dgs {

double steady_clock_s();
void wait_for(torch::Device device);

inline KernelCheckTools kernel_check_tools(const TrainHooks& hooks) {
  KernelCheckTools tools;
  if (hooks.make_kernel_timer) tools.timer = hooks.make_kernel_timer();
  return tools;
}

/// The loss is not finite: the model may be spoilt.
class LossError : public NumericError {
 public:
  using NumericError::NumericError;
};

struct Trainer::Impl {
  /// `config.device` is "cpu" or "cuda".
  Impl(const TrainConfig& config, const Scene& scene, ModelFolder folder, TrainHooks hooks)
      : config(config),
        scene(scene),
        folder(std::move(folder)),
        hooks(std::move(hooks)),
        device(choose_device(config.device)),
        memory(this->hooks.memory ? this->hooks.memory : make_memory_source(device, config.gpu_memory_gb)),
        row_editor([this](auto sizes, const auto& options) { return memory->allocate(sizes, options); }),
        rasterizer(device),
        stepper(rasterizer),
        loss(device),
        kernels(config, device, kernel_check_tools(this->hooks)),
        images(scene.train, device,
               this->hooks.image_budget ? *this->hooks.image_budget
                                        : image_budget(config.image_cache_gb, device, config.gpu_memory_gb),
               this->hooks.on_loading),
        writer(device),
        timer(make_stage_clock(device)),
        time(this->hooks.clock_s ? this->hooks.clock_s : steady_clock_s, [own = device] { wait_for(own); }) {
    if (device.is_cuda() && config.deterministic &&
        evaluation_settings(config, 0).backward_kernel != BackwardKernel::kPerSplat) {
      input_error("--deterministic: the backward kernel ", config.backward_kernel,
                  " adds up in an order that changes from run to run; use --backward_kernel per-splat");
    }
    hold_images(scene.test, this->hooks.on_loading);  // the room that the training views have left
    if (images.size() == 0) input_error(scene.source_path, ": has no view to train on");
  }

  void start();
  void begin();
  void claim_folder();
  /// One iteration with all that it writes. @throws with the checkpoint that was left
  void iterate();
  void finish_files();
  /// What a step takes (ms): by the last interval of the log, else by the whole training; 0 before the first step.
  double step_ms() const;
  BlendInput kernel_check_input();
  void check_kernels(int iteration);
  void step();
  void take_step();
  void settle_loss();
  std::string last_checkpoint() const;
  void learn(const TrainView& view);
  void control_density();
  /// A round of density control, with fewer or no new Gaussians where memory is short.
  void grow();
  void densify_model();
  /// Gaussians for which there is memory; nothing if that is not counted.
  std::optional<std::int64_t> room_for_gaussians();
  /// Whether a hold ends, there being memory for so many (0: any number).
  bool can_grow_on(std::int64_t room) const;
  /// The model does not grow beyond `count` until there is room for more; said unless it has been.
  void hold_count(std::int64_t count);
  /// Gives back what the allocator keeps beyond a share.
  void trim_memory();
  MemoryRemedy wait_for_files();
  MemoryRemedy free_scratch();
  MemoryRemedy release_photographs();
  void collect_times(const std::vector<StageTimes>& known);
  void log_load();
  void log_kernel_times();
  void write_outputs(const OutputPlan& plan);
  void write_ply();
  /// Whether tensors of so many bytes may be copied on the device, to be written beside the training.
  bool has_room_for_copy(std::int64_t bytes);
  void write_checkpoint();
  /// Takes note of files that have been written meanwhile, or could not be.
  void note_files();
  /// After the last one, nothing is written beside the training.
  bool is_last() const { return state.iteration == config.iterations || is_ending; }

  void roll_back();
  void remove_bad_gaussians(const InvalidGaussianError& error);
  /// Does `work` again without the Gaussians that it cannot render.
  template <class Work>
  auto without_bad_gaussians(Work&& work) {
    for (;;) {
      try {
        return work();
      } catch (const InvalidGaussianError& error) {
        remove_bad_gaussians(error);
      }
    }
  }
  /// Leaves a checkpoint, if the state is whole, and throws the exception that is being handled again, with its name.
  [[noreturn]] void end_with_checkpoint();
  std::string save_last_state();
  void report(const char* activity) const;
  void say(const std::string& message) const {
    if (hooks.on_message) hooks.on_message(message);
  }
  void warn(const std::string& message) const {
    if (hooks.on_warning) hooks.on_warning(message);
  }
  /// What the system refuses to write is warned of, and training goes on.
  template <class Work>
  void try_to_write(Work&& work) {
    try {
      work();
    } catch (const IoError& error) {
      warn(error.what());
    }
  }
  RenderSettings step_settings();
  /// Takes the steps that are put off, which is part of training.
  void settle() {
    if (state.gaussians.size() > 0) stepper.settle(state.gaussians, state.adam);
  }
  /// The state with no step put off.
  TrainState& settled() {
    settle();
    return state;
  }
  /// Of training, over all runs so far.
  double elapsed_s() const { return resumed_s + time.train_s(); }
  bool is_stopped() const { return hooks.stop_signal && hooks.stop_signal->load() != 0; }

  const TrainConfig config;
  const Scene& scene;
  const ModelFolder folder;
  const TrainHooks hooks;
  const torch::Device device;

  const std::shared_ptr<MemorySource> memory;
  RowEditor row_editor;
  Rasterizer rasterizer;
  GaussianStepper stepper;
  ImageLoss loss;
  KernelChooser kernels;
  ImageStore images;
  OutputWriter writer;
  StageTimer timer;
  StageAverage stages;
  TimeAccount time;
  double resumed_s = 0;  // of training before this run
  TrainState state;      // to be read through settled() where harmonics or all moments are wanted
  ViewRatios view_ratios;
  bool growth_has_failed = false;  // in this run, although there seemed to be memory
  std::int64_t view_bytes = 0;     // of the rasterizer's buffers after the last view
  TrainResult result;
  /// A step whose loss the host has not read yet.
  struct Unsettled {
    int iteration = 0;
    std::string view;
  };
  std::optional<Unsettled> unsettled;
  /// The state before a step, but for what the step changes last and all at once.
  struct StepStart {
    int iteration = 0, sh_degree = 0;
    std::int64_t adam_steps = 0;
    ViewOrder view_order;
    std::optional<double> loss_average;  // once the step before is in it
  };
  StepStart step_start;
  bool is_whole = true;                      // of one iteration: no change to the state was broken off
  std::filesystem::path resumed;             // the checkpoint
  std::vector<std::string> changed_options;  // since that was written
  nlohmann::ordered_json fingerprint;        // of the scene
  std::vector<WrittenFile> failed;           // of the last iteration done
  bool is_ending = false;
  double checkpoint_s = 0;       // time.train_s() at the last checkpoint
  std::int64_t n_warned_of = 0;  // removed Gaussians
  std::unique_ptr<TrainLog> log;
  int logged_iteration = 0;  // of the last line
  double logged_s = 0;       // time.train_s() there
  double logged_ms = 0;      // of a step before that line; 0: there was none in this run
  int staged_iteration = 0;  // of the last line with times of the stages
};

}  // namespace b3dgs
