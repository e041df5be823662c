// The outputs of a training: what is prepared at the start of a session, and what an iteration evaluates, logs and
// saves.

#include <cmath>

#include "model/disk_space.h"
#include "model/model_folder.h"
#include "model/photographs.h"
#include "train/appearance/exposure_json.h"
#include "train/checkpoint/checkpoint.h"
#include "train/gaussians/floaters.h"
#include "train/ranks/scene_agreement.h"
#include "train/trainer_impl.h"

namespace b3dgs {

nlohmann::ordered_json Trainer::Impl::identify_scene() const {
  nlohmann::ordered_json identity = scene_fingerprint(scene);
  if (!depth_priors) return identity;
  for (const std::filesystem::path& file : depth_map_files(config.depths, scene)) {
    identity["depth_maps"].push_back(photograph_fingerprint(file.string()));
  }
  return identity;
}

/// Marks the folder as the one of this training, and sets aside what it holds of later iterations.
void Trainer::Impl::claim_folder() {
  if (!writes_files()) return;
  own_files.emplace(folder.root());
  if (resumed.empty()) {
    check_holds_no_model(folder);
    state.training_id = new_training_id();
  } else {
    check_training_id(folder, resumed, state.training_id);
    state.training_id = training_id_for(folder);
    const std::filesystem::path aside = set_aside_after(folder, state.iteration);
    if (!aside.empty()) {
      recorder.say(detail::concat("files of iterations after ", state.iteration, " were moved to ", aside.string()));
    }
  }
  folder.write_training_id(state.training_id);
}

/// Prepares the first step of this session. Does nothing when called again.
void Trainer::Impl::begin() {
  if (std::exchange(has_begun, true)) return;
  if (fingerprint.is_null()) fingerprint = identify_scene();
  if (is_distributed()) check_same_scene(*ranks, scene, fingerprint);
  if (state.n_gaussians() == 0) initialize_model();
  claim_folder();
  if (writes_files()) {
    folder.write_inputs(config, scene);
    write_poses();
    if (!state.poses.is_defined()) folder.remove_poses();
    // Those of an earlier session; each PLY keeps its own beside it.
    if (!state.appearance.exposures.defined()) folder.remove_exposures();
  }
  if (config.pose_opt && scene.train.size() < 3) {
    recorder.warn("--pose_opt has no effect: only the first and the last training view exist, whose poses are fixed");
  }
  if (writes_files()) recorder.open_log();
  if (!resumed.empty()) {
    recorder.log_event(state.iteration, "resumed",
                       {{"kernel", kernels.forward_name()},
                        {"backward_kernel", kernels.backward_name()},
                        {"changed_options", changed_options}});
  }
  if (config.batch > 1) {
    const double root = std::sqrt(config.batch);
    recorder.say(detail::concat("steps of ", config.batch, " views: mean gradient, learning rates x ", root,
                                ", Adam's epsilon / ", root, ", betas to the power of ", config.batch));
  }
  const std::int64_t n = state.n_gaussians();
  FirstFiles files{n, ply_bytes(n, config.sh_degree), checkpoint_bytes(state)};
  if (config.antialiasing && !state.gaussians.filters.defined()) {  // until the first step
    files.checkpoint_bytes += n * static_cast<std::int64_t>(sizeof(float));
  }
  const std::string disk = disk_warning(folder.root(), free_disk_bytes(folder.root()), files, config.keep_checkpoints);
  if (!disk.empty()) recorder.warn(disk);
  // If the session before ended between a step and its density control, what was left of that iteration is done now.
  const bool wants_ply = state.iteration > 0 && output_plan(config, first_of_step(), state.iteration, false).save;
  const bool is_complete = state.iteration == config.iterations;
  bool lacks_ply = wants_ply && !std::filesystem::exists(folder.ply(state.iteration));
  // A complete training that is resumed in another folder has its files there, too.
  bool lacks_checkpoint = state.is_density_pending || !std::filesystem::exists(folder.checkpoint(state.iteration));
  if (is_distributed()) agree_on_start(lacks_ply, lacks_checkpoint);
  if (lacks_ply && (state.is_density_pending || is_complete)) write_ply();
  if (state.is_density_pending) control_density();
  if (is_complete && lacks_checkpoint) write_checkpoint();
  if (is_complete) {
    recorder.say(detail::concat("all ", config.iterations, " iterations are done; raise --iterations to train longer"));
    recorder.use_existing_ply();
  }
}

/// How uneven the load of the first view is: always the same view, so that the log shows the effect of training only.
void Trainer::Impl::log_load() {
  const TrainView& view = images.stored_view(0);
  RenderSettings settings = evaluation_settings(config, state.sh_degree);
  settings.keep_for_backward = false;
  without_invalid_gaussians([&] { render(view.camera, settings); });
  recorder.log_event(state.iteration, "load_statistics", load_json(view.name, rasterizer.count_load()));
}

/// Times of the candidate kernels at this point, for plots; nothing is decided.
void Trainer::Impl::log_kernel_times() {
  recorder.report_progress("timing kernels");
  for (const CandidateTiming& timing : kernels.time_candidates(kernel_check_input())) {
    recorder.log_event(state.iteration, "kernel_times", to_json(timing));
  }
}

void Trainer::Impl::log_floaters() {
  recorder.report_progress("counting floaters");
  std::vector<PinholeView> views;
  for (const View& view : with_refined_poses(scene.train, scene.train, state.poses)) {
    views.push_back(to_pinhole_view(view.camera));
  }
  try {
    const FloaterCount count = with_remedies({wait_for_files(), free_scratch()}, [&] {
      return count_floaters(rasterizer, flushed_state().gaussians, views, evaluation_settings(config, state.sh_degree));
    });
    recorder.log_event(
        state.iteration, "floaters",
        {{"unseen", count.unseen}, {"one_view", count.one_view}, {"close", count.close}, {"large", count.large}});
  } catch (const OutOfMemoryError&) {  // the model that has been trained is worth more than this count
    recorder.say("floaters were not counted: not enough memory");
  } catch (const std::exception& error) {
    const std::string text = error.what();
    recorder.say("floaters were not counted: " + text.substr(0, text.find('\n')));
  }
}

ColorEvaluation Trainer::Impl::color_evaluation() const {
  ColorEvaluation colors = b3dgs::color_evaluation(config);
  if (state.appearance.exposures.defined()) {
    colors.exposures = named_exposures(state.appearance.exposures, scene.train);
  }
  return colors;
}

std::optional<ImageQuality> Trainer::Impl::evaluate_test_views() {
  recorder.report_progress("evaluating");
  const Evaluation evaluation = without_invalid_gaussians([&] {
    return evaluate_views([this](auto&&... view) { return render(view...); }, device, scene.test,
                          evaluation_settings(config, state.sh_degree), {}, /*lpips=*/nullptr, color_evaluation());
  });
  recorder.add_evaluation(evaluation, evaluation_source(config, scene.test, "test"));
  if (evaluation.views.empty()) return std::nullopt;
  return evaluation.mean;
}

void Trainer::Impl::write_outputs(const OutputPlan& plan) {
  std::optional<ImageQuality> test_quality;
  if (plan.statistics || plan.kernel_times || plan.evaluate) {
    on_first_rank([&] {
      if (plan.statistics) log_load();
      if (plan.kernel_times) log_kernel_times();
      if (plan.evaluate) test_quality = evaluate_test_views();
    });
  }
  if (plan.log && writes_files()) {
    recorder.log_iteration(test_quality, kernels.forward_name(), kernels.backward_name());
  }
  if (plan.save) write_ply();
}

void Trainer::Impl::write_ply() {
  recorder.report_progress("saving");
  if (state.appearance.exposures.defined() && writes_files()) {
    recorder.write_exposures(named_exposures(state.appearance.exposures, scene.train));
  }
  if (is_distributed()) {
    const GaussianTensors whole = gathered_gaussians();
    if (writes_files()) recorder.write_ply(whole);
  } else {
    recorder.write_ply(flushed_state().gaussians);
  }
  if (writes_files()) recorder.try_to_write([&] { write_poses(); });
}

void Trainer::Impl::write_poses() {
  if (!state.poses.is_defined()) return;
  folder.write_poses(scene, with_refined_poses(scene.train, scene.train, state.poses));
}

void Trainer::Impl::write_checkpoint() {
  recorder.report_progress("checkpoint");
  read_loss();
  state.elapsed_s = recorder.elapsed_s();
  if (is_distributed()) return write_checkpoint_of_ranks();
  recorder.write_checkpoint(flushed_state(), fingerprint);
}

}  // namespace b3dgs
