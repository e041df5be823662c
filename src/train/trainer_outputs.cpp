#include <cmath>

#include "config/output_plan.h"
#include "core/text.h"
#include "model/model_folder.h"
#include "train/appearance/appearance_model.h"
#include "train/checkpoint/checkpoint.h"
#include "train/density_control.h"
#include "train/gaussians/gaussian_model.h"
#include "train/step_runner.h"
#include "train/team.h"
#include "train/trainer.h"
#include "train/training.h"

namespace b3dgs {

void Trainer::mark_folder() {
  const ModelFolder& folder = training_->folder;
  own_files_ = std::make_unique<OwnFiles>(folder.root());
  state_.training_id = claim_training_id(folder, resumed_, state_.training_id);
  if (!resumed_.empty()) {
    const std::filesystem::path aside = set_aside_after(folder, state_.iteration);
    if (!aside.empty()) {
      recorder_.say(detail::concat("files of iterations after ", state_.iteration, " were moved to ", aside.string()));
    }
  }
  folder.write_training(state_.training_id, scene_.frame.unit);
  folder.write_inputs(config_, scene_);
  write_poses();
  if (!state_.poses.is_defined()) folder.clear(folder.poses());
  // Exposures of an earlier session. Each PLY keeps its own copy beside it.
  if (!state_.appearance.exposures.defined()) folder.clear(folder.exposures());
}

void Trainer::warn_of_disk_space() {
  const std::int64_t n = state_.n_gaussians();
  FirstFiles files{n, ply_bytes(n, config_.sh_degree), checkpoint_bytes(state_)};
  if (config_.antialiasing && !state_.gaussians.filters.defined()) {  // computed in the first step
    files.checkpoint_bytes += n * static_cast<std::int64_t>(sizeof(float));
  }
  const std::filesystem::path& root = training_->folder.root();
  const int n_checkpoints = config_.keep_checkpoints + static_cast<int>(config_.checkpoint_iterations.size());
  const std::string warning = disk_warning(root, free_disk_bytes(root), files, n_checkpoints);
  if (!warning.empty()) recorder_.warn(warning);
}

void Trainer::begin() {
  if (has_begun_) return;
  if (training_->fingerprint.is_null()) training_->fingerprint = scene_identity(*training_);
  ensure_model();
  team_->on_first([&] { mark_folder(); });
  if (config_.pose_opt && scene_.train.size() < 3) {
    recorder_.warn("--pose_opt has no effect: only the first and the last training view exist, whose poses are fixed");
  }
  team_->on_first([&] { recorder_.open_log(); });
  has_begun_ = true;
  if (!resumed_.empty()) {
    recorder_.log_event(state_.iteration, "resumed",
                        {{"kernel", training_->kernels.kernel()}, {"changed_options", changed_options_}});
  }
  if (config_.kernel == kPublishedKernel && training_->device.is_cpu()) {
    recorder_.say(
        "--kernel published: on a CPU, a blend with the paper's balanced kernel takes up to 18 times as long as with " +
        std::string("the default; it is meant for GPUs"));
  }
  if (config_.batch > 1) {
    const double root = std::sqrt(config_.batch);
    recorder_.say(detail::concat("steps of ", config_.batch, " views: mean gradient, learning rates x ", root,
                                 ", Adam's epsilon / ", root, ", betas to the power of ", config_.batch));
  }
  warn_of_disk_space();
  // If the previous session ended between a step and its density control, the rest of that iteration is done now.
  const bool is_complete = state_.iteration == config_.iterations;
  const bool wants_ply =
      state_.iteration > 0 && output_plan(config_, state_.first_of_step(), state_.iteration, false).save;
  const bool lacks_ply =
      team_->ask_first("missing PLY", wants_ply && !std::filesystem::exists(training_->folder.ply(state_.iteration)));
  // A complete training that is resumed in another folder writes its files there, too.
  const bool lacks_checkpoint = team_->ask_first(
      "missing checkpoint",
      state_.n_density_pending > 0 || !std::filesystem::exists(training_->folder.checkpoint(state_.iteration)));
  if (lacks_ply && (state_.n_density_pending > 0 || is_complete)) write_ply();
  density_control_->run();
  if (is_complete && lacks_checkpoint) write_state();
  if (is_complete) {
    recorder_.say(
        detail::concat("all ", config_.iterations, " iterations are done; raise --iterations to train longer"));
    recorder_.use_existing_ply();
  }
}

void Trainer::render_on_first(const std::function<void(const RenderModelFn&)>& work) {
  step_runner_->read_losses();
  team_->render_on_first(work);
}

/// Logs how uneven the load of some views is. These are always the same views, so that the log shows the effect of
/// training only.
void Trainer::log_load(const RenderModelFn& render) {
  constexpr int kMostViews = 4;
  const int n = std::min(kMostViews, training_->views.size());
  RenderSettings settings = base_render_settings(config_, state_.sh_degree);
  settings.kernel = kernel_named(training_->kernels.kernel());  // so that tiles are those of training
  settings.keep_for_backward = false;
  std::vector<ViewLoad> loads;
  for (int i = 0; i < n; ++i) {
    const TrainView& view = training_->views.images.stored_view(training_->views.size() * i / n);
    loads.push_back(with_remedies(training_->remedies(), [&] {
      step_runner_->without_invalid_gaussians([&] { render(view.camera, settings); });
      return training_->rasterizer.count_load();
    }));
  }
  recorder_.log_event(state_.iteration, "load_statistics", load_json(loads));
}

void Trainer::log_floaters() {
  recorder_.report_progress("counting floaters");
  std::vector<CameraView> views;
  for (const View& view : with_refined_poses(scene_.train, scene_.train, state_.poses)) {
    views.push_back(to_camera_view(view.camera));
  }
  try {
    const FloaterCount count = with_remedies({training_->waiting_for_files(), training_->freeing_scratch()}, [&] {
      return count_floaters(training_->rasterizer, training_->flushed_state().gaussians, views,
                            base_render_settings(config_, state_.sh_degree));
    });
    recorder_.log_event(
        state_.iteration, "floaters",
        {{"unseen", count.unseen}, {"one_view", count.one_view}, {"close", count.close}, {"large", count.large}});
  } catch (const OutOfMemoryError&) {  // a failure of this count must not end the training
    recorder_.say("floaters were not counted: not enough memory");
  } catch (const std::exception& error) {
    recorder_.say("floaters were not counted: " + first_line(error.what()));
  }
}

Evaluation Trainer::evaluate_with(const RenderModelFn& render, const std::vector<View>& views,
                                  const RenderedFn& on_rendered) {
  ColorEvaluation colors = color_evaluation(config_);
  if (state_.appearance.exposures.defined()) {
    colors.exposures = named_exposures(state_.appearance.exposures, scene_.train);
  }
  RenderSettings settings = base_render_settings(config_, state_.sh_degree);
  settings.keep_for_backward = false;
  const RenderFn render_view = [&](const CameraView& view) { return render(view, settings); };
  return with_remedies(training_->remedies(), [&] {
    return step_runner_->without_invalid_gaussians(
        [&] { return evaluate_views(render_view, training_->device, views, on_rendered, /*lpips=*/nullptr, colors); });
  });
}

void Trainer::write_outputs(const OutputPlan& plan) {
  std::optional<ImageQuality> test_quality;
  if (plan.load || plan.evaluate) {
    render_on_first([&](const RenderModelFn& render) {
      if (plan.load) log_load(render);
      if (!plan.evaluate) return;
      recorder_.report_progress("evaluating");
      const std::vector<View>& views = scene_.test;
      const Evaluation evaluation = evaluate_with(render, views, {});
      recorder_.add_evaluation(evaluation, evaluation_source(config_, views, "test"));
      if (!evaluation.views.empty()) test_quality = evaluation.mean;
    });
  }
  if (plan.log) {
    team_->on_first([&] { recorder_.log_iteration(test_quality, training_->kernels.kernel()); });
  }
  if (plan.save) write_ply();
}

void Trainer::write_ply() {
  const torch::Tensor& exposures = state_.appearance.exposures;
  const ModelFolder& folder = training_->folder;
  recorder_.report_progress("saving");
  const GaussianTensors whole = team_->gather_gaussians();
  team_->on_first([&] {
    if (exposures.defined()) {
      recorder_.try_to_write([&] {
        const Exposures named = named_exposures(exposures, scene_.train);
        write_exposures(folder.exposures(state_.iteration), named);
        write_exposures(folder.exposures(), named);
      });
    }
    recorder_.write_ply(whole);
    recorder_.try_to_write([&] { write_poses(); });
  });
}

void Trainer::write_poses() {
  const PoseState& poses = state_.poses;
  if (!poses.is_defined()) return;
  training_->folder.write_poses(scene_, with_refined_poses(scene_.train, scene_.train, poses));
}

void Trainer::write_state() {
  recorder_.report_progress("checkpoint");
  step_runner_->read_losses();
  state_.elapsed_s = recorder_.elapsed_s();
  team_->write_checkpoint();
}

}  // namespace b3dgs
