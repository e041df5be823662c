#include <cmath>

#include "config/output_plan.h"
#include "core/text.h"
#include "model/model_folder.h"
#include "train/appearance/appearance_model.h"
#include "train/checkpoint/checkpoint.h"
#include "train/density_control.h"
#include "train/gaussians/gaussian_model.h"
#include "train/stepper.h"
#include "train/trainer.h"
#include "train/training.h"

namespace b3dgs {

void Trainer::claim_folder() {
  if (!stepper_->writes_files()) return;
  const ModelFolder& folder = training_->folder;
  TrainState& state = training_->state;
  own_files_.emplace(folder.root());
  state.training_id = claim_training_id(folder, resumed_, state.training_id);
  if (!resumed_.empty()) {
    const std::filesystem::path aside = set_aside_after(folder, state.iteration);
    if (!aside.empty()) {
      training_->recorder.say(
          detail::concat("files of iterations after ", state.iteration, " were moved to ", aside.string()));
    }
  }
  folder.write_training_id(state.training_id);
  folder.write_inputs(training_->config, training_->scene);
  write_poses();
  if (!state.poses.is_defined()) folder.clear(folder.poses());
  // Those of an earlier session; each PLY keeps its own beside it.
  if (!state.appearance.exposures.defined()) folder.clear(folder.exposures());
}

void Trainer::warn_of_disk_space() {
  const TrainState& state = training_->state;
  const std::int64_t n = state.n_gaussians();
  FirstFiles files{n, ply_bytes(n, training_->config.sh_degree), checkpoint_bytes(state)};
  if (training_->config.antialiasing && !state.gaussians.filters.defined()) {  // until the first step
    files.checkpoint_bytes += n * static_cast<std::int64_t>(sizeof(float));
  }
  const std::filesystem::path& root = training_->folder.root();
  const std::string warning = disk_warning(root, free_disk_bytes(root), files, training_->config.keep_checkpoints);
  if (!warning.empty()) training_->recorder.warn(warning);
}

void Trainer::begin() {
  if (has_begun_) return;
  const TrainConfig& config = training_->config;
  const TrainState& state = training_->state;
  TrainRecorder& recorder = training_->recorder;
  if (training_->fingerprint.is_null()) training_->fingerprint = scene_identity(*training_);
  stepper_->check_same_scene(training_->fingerprint);
  ensure_model();
  claim_folder();
  if (config.pose_opt && training_->scene.train.size() < 3) {
    recorder.warn("--pose_opt has no effect: only the first and the last training view exist, whose poses are fixed");
  }
  if (stepper_->writes_files()) recorder.open_log();
  has_begun_ = true;
  if (!resumed_.empty()) {
    recorder.log_event(state.iteration, "resumed",
                       {{"kernel", training_->kernels.forward_name()},
                        {"backward_kernel", training_->kernels.backward_name()},
                        {"changed_options", changed_options_}});
  }
  if (config.batch > 1) {
    const double root = std::sqrt(config.batch);
    recorder.say(detail::concat("steps of ", config.batch, " views: mean gradient, learning rates x ", root,
                                ", Adam's epsilon / ", root, ", betas to the power of ", config.batch));
  }
  warn_of_disk_space();
  // If the session before ended between a step and its density control, what was left of that iteration is done now.
  const bool is_complete = state.iteration == config.iterations;
  const bool wants_ply = state.iteration > 0 && output_plan(config, state.first_of_step(), state.iteration, false).save;
  Stepper::Missing missing;
  missing.ply = wants_ply && !std::filesystem::exists(training_->folder.ply(state.iteration));
  // A complete training that is resumed in another folder has its files there, too.
  missing.checkpoint =
      state.n_density_pending > 0 || !std::filesystem::exists(training_->folder.checkpoint(state.iteration));
  missing = stepper_->agree_on_start(missing);
  if (missing.ply && (state.n_density_pending > 0 || is_complete)) write_ply();
  density_control_->run();
  if (is_complete && missing.checkpoint) write_state();
  if (is_complete) {
    recorder.say(detail::concat("all ", config.iterations, " iterations are done; raise --iterations to train longer"));
    recorder.use_existing_ply();
  }
}

BlendInput Trainer::kernel_check_input() {
  const auto render = [this](const CameraView& view, const RenderSettings& settings) {
    return stepper_->render(view, settings);
  };
  BlendInput input{training_->rasterizer,
                   render,
                   evaluation_settings(training_->config, training_->state.sh_degree),
                   {},
                   training_->remedies()};
  for (const std::int32_t view : training_->views.upcoming(training_->state.view_order, KernelChooser::kViews)) {
    input.views.push_back(training_->views.images.stored_view(view).camera);
  }
  return input;
}

/// How uneven the load of the first view is: always the same view, so that the log shows the effect of training only.
void Trainer::log_load() {
  const TrainView& view = training_->views.images.stored_view(0);
  RenderSettings settings = evaluation_settings(training_->config, training_->state.sh_degree);
  settings.keep_for_backward = false;
  const ViewLoad load = with_remedies(training_->remedies(), [&] {
    stepper_->without_invalid_gaussians([&] { stepper_->render(view.camera, settings); });
    return training_->rasterizer.count_load();
  });
  training_->recorder.log_event(training_->state.iteration, "load_statistics", load_json(view.name, load));
}

/// Times of the candidate kernels at this point, for plots; nothing is decided.
void Trainer::log_kernel_times() {
  training_->recorder.report_progress("timing kernels");
  for (const CandidateTiming& timing : training_->kernels.time_candidates(kernel_check_input())) {
    training_->recorder.log_event(training_->state.iteration, "kernel_times", to_json(timing));
  }
}

void Trainer::log_floaters() {
  const Scene& scene = training_->scene;
  TrainRecorder& recorder = training_->recorder;
  recorder.report_progress("counting floaters");
  std::vector<CameraView> views;
  for (const View& view : with_refined_poses(scene.train, scene.train, training_->state.poses)) {
    views.push_back(to_camera_view(view.camera));
  }
  try {
    const FloaterCount count = with_remedies({training_->wait_for_files(), training_->free_scratch()}, [&] {
      return count_floaters(training_->rasterizer, stepper_->flushed_state().gaussians, views,
                            evaluation_settings(training_->config, training_->state.sh_degree));
    });
    recorder.log_event(
        training_->state.iteration, "floaters",
        {{"unseen", count.unseen}, {"one_view", count.one_view}, {"close", count.close}, {"large", count.large}});
  } catch (const OutOfMemoryError&) {  // the model that has been trained is worth more than this count
    recorder.say("floaters were not counted: not enough memory");
  } catch (const std::exception& error) {
    recorder.say("floaters were not counted: " + first_line(error.what()));
  }
}

Evaluation Trainer::evaluate_here(const std::vector<View>& views, const RenderedFn& on_rendered) {
  ColorEvaluation colors = color_evaluation(training_->config);
  if (training_->state.appearance.exposures.defined()) {
    colors.exposures = named_exposures(training_->state.appearance.exposures, training_->scene.train);
  }
  return with_remedies(training_->remedies(), [&] {
    return stepper_->without_invalid_gaussians([&] {
      return evaluate_views([&](auto&&... view) { return stepper_->render(view...); }, training_->device, views,
                            evaluation_settings(training_->config, training_->state.sh_degree), on_rendered,
                            /*lpips=*/nullptr, colors);
    });
  });
}

std::optional<ImageQuality> Trainer::evaluate_test_views() {
  const std::vector<View>& views = training_->scene.test;
  training_->recorder.report_progress("evaluating");
  const Evaluation evaluation = evaluate_here(views, {});
  training_->recorder.add_evaluation(evaluation, evaluation_source(training_->config, views, "test"));
  if (evaluation.views.empty()) return std::nullopt;
  return evaluation.mean;
}

void Trainer::write_outputs(const OutputPlan& plan) {
  std::optional<ImageQuality> test_quality;
  if (plan.statistics || plan.kernel_times || plan.evaluate) {
    stepper_->on_first([&] {
      if (plan.statistics) log_load();
      if (plan.kernel_times) log_kernel_times();
      if (plan.evaluate) test_quality = evaluate_test_views();
    });
  }
  if (plan.log && stepper_->writes_files()) {
    training_->recorder.log_iteration(test_quality, training_->kernels.forward_name(),
                                      training_->kernels.backward_name());
  }
  if (plan.save) write_ply();
}

void Trainer::write_ply() {
  const torch::Tensor& exposures = training_->state.appearance.exposures;
  training_->recorder.report_progress("saving");
  const GaussianTensors whole = stepper_->whole_gaussians();
  if (!stepper_->writes_files()) return;
  if (exposures.defined()) training_->recorder.write_exposures(named_exposures(exposures, training_->scene.train));
  training_->recorder.write_ply(whole);
  training_->recorder.try_to_write([&] { write_poses(); });
}

void Trainer::write_poses() {
  const PoseState& poses = training_->state.poses;
  if (!poses.is_defined()) return;
  const Scene& scene = training_->scene;
  training_->folder.write_poses(scene, with_refined_poses(scene.train, scene.train, poses));
}

void Trainer::write_state() {
  training_->recorder.report_progress("checkpoint");
  stepper_->complete_pending();
  training_->state.elapsed_s = training_->recorder.elapsed_s();
  stepper_->write_checkpoint(training_->fingerprint);
}

}  // namespace b3dgs
