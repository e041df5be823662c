#include "train/trainer.h"

#include <c10/util/Exception.h>

#include <algorithm>
#include <cstring>
#include <new>
#include <utility>

#include "config/output_plan.h"
#include "config/train_options.h"
#include "core/text.h"
#include "train/checkpoint/checkpoint.h"
#include "train/density_control.h"
#include "train/device.h"
#include "train/gaussians/gaussian_model.h"
#include "train/scene_limits.h"
#include "train/step.h"
#include "train/step_runner.h"
#include "train/team.h"
#include "train/training.h"

namespace b3dgs {
namespace {

constexpr const char* kNoCheckpoint = "; a checkpoint could not be written either: ";

bool is_out_of_memory(const std::exception& error) {
  if (dynamic_cast<const OutOfMemoryError*>(&error) != nullptr) return true;
  if (dynamic_cast<const Error*>(&error) != nullptr) return false;
  return dynamic_cast<const std::bad_alloc*>(&error) != nullptr ||
         dynamic_cast<const c10::OutOfMemoryError*>(&error) != nullptr ||
         std::strstr(error.what(), "allocate memory") != nullptr ||  // LibTorch's message on a CPU
         std::strstr(error.what(), "out of memory") != nullptr;
}

std::unique_ptr<Training> make_training(const FinalConfig& config, const Scene& scene, ModelFolder folder,
                                        TrainHooks hooks) {
  set_compute_threads(config.options.threads);
  return std::make_unique<Training>(config, scene, std::move(folder), std::move(hooks));
}

}  // namespace

Trainer::Trainer(const FinalConfig& config, const Scene& scene, ModelFolder folder, TrainHooks hooks)
    : training_(make_training(config, scene, std::move(folder), std::move(hooks))),
      config_(training_->config),
      scene_(scene),
      state_(training_->state),
      time_(training_->time),
      recorder_(training_->recorder) {
  const auto& make_team = training_->hooks.make_team;
  team_ = make_team ? make_team(*training_) : std::make_unique<Team>(*training_);
  step_runner_ = std::make_unique<StepRunner>(*training_, *team_);
  density_control_ = std::make_unique<DensityControl>(*training_, *team_);
}
Trainer::~Trainer() = default;

void Trainer::ensure_model() {
  if (state_.n_gaussians() > 0) return;
  const SplatCloud cloud = initial_splats(config_, scene_);
  for (const std::string& note : cloud.notes) recorder_.warn(note);
  if (!config_.crop.empty()) {
    const CropRegion region = parse_crop(config_.crop);
    std::int64_t n_inside = 0;
    for (std::size_t i = 0; i < cloud.means.size(); i += 3) {
      n_inside += region.contains(cloud.frame.to_world(&cloud.means[i])) ? 1 : 0;
    }
    if (n_inside == 0) {
      input_error("--crop ", config_.crop, ": none of the ", format_count(cloud.size()),
                  " initial Gaussians is inside; choose the region in b3dgs view");
    }
    recorder_.say(detail::concat("crop        ", format_count(n_inside), " of ", format_count(cloud.size()),
                                 " initial Gaussians are inside"));
  }
  if (cloud.antialiased && !config_.antialiasing) {
    recorder_.warn(config_.init_ply + " was trained with --antialiasing, but this training renders without " +
                   "it: splats that are small in the image become too opaque; add --antialiasing");
  }
  state_.sh_degree = std::min(cloud.sh_degree, config_.sh_degree);
  state_.gaussians = to_tensors(cloud, config_.sh_degree, training_->whole_device);
  team_->distribute_model();
  state_.adam = make_adam_state(state_.gaussians);
  state_.statistics = training_->density->make_statistics(state_.gaussians.size(), training_->device);
  training_->prepare_appearance();
  const std::string warning = near_plane_warning(cloud.means, scene_.train, config_.near_plane);
  if (!warning.empty()) recorder_.warn(warning);
  if (scene_.train.size() == 1) {
    recorder_.warn(
        "only one training view: other views will look wrong; a scene needs 20 photographs or more, each overlapping "
        "its neighbours");
  }
  if (config_.max_gaussians > 0 && state_.n_gaussians() > config_.max_gaussians) {
    recorder_.warn(detail::concat("training starts with ", state_.n_gaussians(),
                                  " Gaussians, more than --max_gaussians ", config_.max_gaussians,
                                  "; none will be added"));
  }
}

std::vector<std::string> Trainer::resume(const std::filesystem::path& checkpoint) {
  Checkpoint read = read_checkpoint(checkpoint, scene_, training_->whole_device);
  check_resume_options(read.config, read.state.iteration, config_, checkpoint.string());
  if (training_->fingerprint.is_null()) training_->fingerprint = scene_identity(*training_);
  for (const std::string& change : scene_changes(read.header, training_->fingerprint)) {
    recorder_.warn(change);
  }
  state_ = std::move(read.state);
  if (!config_.antialiasing) state_.gaussians.filters = torch::Tensor();
  team_->distribute_model();
  training_->prepare_appearance();
  // Another strategy may have other statistics, so a new round of statistics begins.
  if (read.config.strategy != config_.strategy) {
    state_.statistics = training_->density->make_statistics(state_.gaussians.size(), training_->device);
  }
  resumed_ = checkpoint;
  recorder_.resume_from(checkpoint, state_.elapsed_s);
  result_.first_iteration = state_.iteration;
  training_->kernels.restore(state_.kernel_selection, checkpoint.string());
  std::error_code error;  // ignored: on an error the folders count as different
  if (std::filesystem::equivalent(read.config.model_path, config_.model_path, error)) {
    read.config.model_path = config_.model_path;  // the same folder under another name
  }
  changed_options_ = config_differences(read.config, config_);
  return changed_options_;
}

TrainResult Trainer::run(std::optional<int> until) {
  const int last = until.value_or(config_.iterations);
  B3DGS_CHECK(last <= config_.iterations, "iteration ", last, " of ", config_.iterations);
  begin();
  while (state_.iteration < last && !result_.interrupted) {
    try {
      run_iteration();
    } catch (const LossError&) {
      throw;
    } catch (const std::exception& error) {
      end_with_checkpoint(error);
    }
  }
  if (state_.iteration == config_.iterations && state_.iteration > 0)
    step_runner_->warn_of_empty_views(state_.iteration);
  time_.finish_training();
  wait();
  time_.output([&] { recorder_.finish_files(); });
  static_cast<TrainOutputs&>(result_) = recorder_.outputs();
  result_.train_s = time_.train_s();
  result_.output_s = time_.output_s();
  result_.iteration = state_.iteration;
  result_.n_gaussians = state_.n_gaussians();
  result_.peak_memory_bytes = training_->memory->use().peak_reserved;
  result_.n_removed = state_.n_removed;
  return result_;
}

void Trainer::step() {
  ensure_model();
  time_.begin_training();
  step_runner_->run_step();
  density_control_->run();
  time_.end_training();
  recorder_.collect_stage_times();
}

void Trainer::wait() {
  step_runner_->read_losses();
  if (state_.iteration == config_.iterations) decide_kernel(*training_, state_.iteration + 1);
  recorder_.wait_for_stage_times();
}

void Trainer::run_iteration() {
  time_.begin_training();
  step_runner_->run_step();
  recorder_.report_progress("training");
  time_.end_training();
  const bool is_last = state_.iteration == config_.iterations;
  const OutputPlan plan = output_plan(config_, state_.first_of_step(), state_.iteration, !scene_.test.empty());
  const bool renders_or_saves = plan.load || plan.evaluate || plan.save;
  // On a GPU, reading the loss waits for most of the step, so it is done only if needed.
  const bool ends = team_->requests().stop;
  if (plan.log || renders_or_saves || plan.checkpoint || ends) time_.train([&] { step_runner_->read_losses(); });
  if (renders_or_saves || plan.checkpoint || ends) time_.train([&] { training_->flush(); });
  if (renders_or_saves) {
    time_.output([&] { write_outputs(plan); });
  } else if (plan.log) {
    // The device is still computing. Counting the log line as output would mean waiting for the device, and would not
    // count the part of the step that runs meanwhile.
    time_.train([&] { write_outputs(plan); });
  }
  if (is_last) {
    time_.output([&] {
      render_on_first([&](const RenderModelFn&) {
        if (training_->hooks.on_last_files_written) recorder_.try_to_write(training_->hooks.on_last_files_written);
      });
    });
  }
  // If the last PLY could not be written, density control is left to the resumed training, which writes that PLY first.
  if (!is_last || team_->ask_first("files", recorder_.failed_files().empty()))
    time_.train([&] { density_control_->run(); });
  if (training_->hooks.wants_model && training_->hooks.wants_model()) show_model();
  result_.interrupted = !is_last && team_->requests().stop;
  recorder_.set_ending(result_.interrupted);
  if (plan.checkpoint || result_.interrupted || team_->requests().write_checkpoint)
    time_.output([&] { write_state(); });
  if (result_.interrupted && !plan.save) time_.output([&] { write_ply(); });
  // With several processes, no single one holds the whole model on its device.
  if (is_last && state_.is_whole() && !training_->is_stopped()) time_.output([&] { log_floaters(); });
  if (training_->hooks.wait_for_files) recorder_.wait_for_files();
  recorder_.collect_files();
}

void Trainer::show_model() {
  time_.train([&] {
    step_runner_->read_losses();
    training_->flush();
  });
  time_.output([&] {
    const TrainState& whole = training_->flushed_state();
    training_->hooks.on_model(
        {whole.iteration, whole.gaussians, whole.poses, whole.sh_degree, training_->kernels.kernel()});
  });
}

Evaluation Trainer::evaluate(const std::vector<View>& views, const RenderedFn& on_rendered) {
  B3DGS_CHECK(has_begun_, "evaluate() before run()");
  Evaluation evaluation;
  render_on_first([&](const RenderModelFn& render) {
    evaluation = evaluate_with(render, with_refined_poses(views, scene_.train, state_.poses), on_rendered);
  });
  return evaluation;
}

std::filesystem::path Trainer::write_checkpoint() {
  B3DGS_CHECK(has_begun_, "write_checkpoint() before run()");
  // A failure of files that are still being written is only a warning, as during training.
  recorder_.wait_for_files();
  recorder_.collect_files();
  recorder_.set_ending(true);  // the file is on disk when write_state() returns
  write_state();
  recorder_.set_ending(false);
  recorder_.require_checkpoint();
  return recorder_.outputs().checkpoint;
}

std::filesystem::path Trainer::save() {
  B3DGS_CHECK(state_.is_whole(), "save() with several processes");
  std::filesystem::path checkpoint = write_checkpoint();
  if (!std::filesystem::exists(training_->folder.ply(state_.iteration))) {
    recorder_.set_ending(true);
    write_ply();
    recorder_.set_ending(false);
  }
  return checkpoint;
}

std::string Trainer::describe_images() const {
  return "for training " + describe(training_->views.images.places()) + "; for testing " +
         describe(places_of(scene_.test));
}

std::optional<MemoryForecast> Trainer::forecast_memory() {
  const std::optional<std::int64_t> limit = training_->memory->limit();
  if (!limit) return std::nullopt;
  ensure_model();
  return b3dgs::forecast_memory(*training_, *limit);
}

// --- Failures ---

std::string Trainer::save_last_state() {
  const int iteration = state_.iteration;
  if (!team_->can_save()) return training_->last_checkpoint();
  if (iteration == 0) return "";
  step_runner_->read_losses();
  if (!training_->is_consistent) return training_->last_checkpoint();
  training_->freeing_scratch()();
  recorder_.set_ending(true);
  write_state();
  if (!team_->ask_first("files", recorder_.failed_files().empty())) {
    const std::vector<WrittenFile>& failed = recorder_.failed_files();
    return kNoCheckpoint + (failed.empty() ? "see rank 0" : failed.back().error) + training_->last_checkpoint();
  }
  return detail::concat("; iteration ", iteration, " is saved, ",
                        training_->resume_words(training_->folder.checkpoint(iteration)));
}

void Trainer::end_with_checkpoint(const std::exception& cause) {
  std::string saved;
  try {
    saved = save_last_state();
  } catch (const LossError&) {
    throw;
  } catch (const std::exception& error) {
    saved = kNoCheckpoint + first_line(error.what()) + training_->last_checkpoint();
  }
  if (is_out_of_memory(cause)) {
    throw OutOfMemoryError(detail::concat("out of memory after iteration ", state_.iteration, ", with ",
                                          state_.n_gaussians(), " Gaussians", saved));
  }
  if (const auto* const known = dynamic_cast<const Error*>(&cause)) known->rethrow_with(saved);
  throw Error(first_line(cause.what()) + saved);
}

}  // namespace b3dgs
