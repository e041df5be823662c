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
#include "train/stepper.h"
#include "train/training.h"

namespace b3dgs {
namespace {

constexpr const char* kNoCheckpoint = "; a checkpoint could not be written either: ";

bool is_out_of_memory(const std::exception& error) {
  if (dynamic_cast<const OutOfMemoryError*>(&error) != nullptr) return true;
  if (dynamic_cast<const Error*>(&error) != nullptr) return false;
  return dynamic_cast<const std::bad_alloc*>(&error) != nullptr ||
         dynamic_cast<const c10::OutOfMemoryError*>(&error) != nullptr ||
         std::strstr(error.what(), "allocate memory") != nullptr ||  // LibTorch's on a CPU
         std::strstr(error.what(), "out of memory") != nullptr;
}

/// While it lives, files are on disk when the call that writes them returns.
class Ending {
 public:
  explicit Ending(TrainRecorder& recorder) : recorder_(recorder) { recorder_.set_ending(true); }
  ~Ending() { recorder_.set_ending(false); }
  Ending(const Ending&) = delete;
  Ending& operator=(const Ending&) = delete;

 private:
  TrainRecorder& recorder_;
};

std::unique_ptr<Stepper> make_stepper(Training& training) {
  if (training.hooks.make_stepper) return training.hooks.make_stepper(training);
  return std::make_unique<Stepper>(training);
}

}  // namespace

void check_options(const TrainConfig& config) {
  if (choose_device(config.device).is_cuda() && config.deterministic &&
      evaluation_settings(config, 0).backward_kernel != BackwardKernel::kPerBucket) {
    input_error("--deterministic: the backward kernel ", config.backward_kernel,
                " sums in an order that differs from run to run; use --backward_kernel per-bucket");
  }
  const bool grows = config.max_gaussians == 0 && config.gaussians_per_pixel == 0;
  if (config.strategy == "mcmc" && grows && choose_device(config.device).is_cpu()) {
    input_error(
        "--strategy mcmc --max_gaussians 0: expected a limit on a CPU, where free memory does not limit growth; ",
        "give one, such as --max_gaussians 1000000");
  }
  if (config.exposure && config.bilateral_grid) {
    input_error("--exposure and --bilateral_grid cannot be used together; the grid includes what an exposure does");
  }
  if (config.train_test_exp && !config.eval) {
    input_error("--train_test_exp: needs test views; add --eval, or leave it out");
  }
  if (!config.init_ply.empty()) holds_splats(config.init_ply);  // reads the header
}

Trainer::Trainer(const TrainConfig& config, const Scene& scene, ModelFolder folder, TrainHooks hooks) {
  check_scene_options(config, scene);
  set_compute_threads(config.threads);
  TrainConfig resolved = with_scene_limits(config, scene);
  resolved.device = device_name(choose_device(config.device));
  check_options(resolved);
  training_ = std::make_unique<Training>(resolved, scene, std::move(folder), std::move(hooks));
  stepper_ = make_stepper(*training_);
  density_control_ = std::make_unique<DensityControl>(*training_, *stepper_);
}
Trainer::~Trainer() = default;

int Trainer::iteration() const {
  return training_->state.iteration;
}

std::int64_t Trainer::n_gaussians() const {
  return training_->state.n_gaussians();
}

int Trainer::sh_degree() const {
  return training_->state.sh_degree;
}

void Trainer::ensure_model() {
  if (training_->state.n_gaussians() > 0) return;
  const TrainConfig& config = training_->config;
  const Scene& scene = training_->scene;
  TrainState& state = training_->state;
  const SplatCloud cloud = initial_splats(config, scene);
  if (cloud.antialiased && !config.antialiasing) {
    training_->recorder.warn(config.init_ply + " was trained with --antialiasing, but this training renders without " +
                             "it: splats that are small in the image become too opaque; add --antialiasing");
  }
  state.sh_degree = std::min(cloud.sh_degree, config.sh_degree);
  state.gaussians = to_tensors(cloud, config.sh_degree, stepper_->load_device());
  stepper_->adopt_model();
  state.adam = make_adam_state(state.gaussians);
  state.statistics = training_->density->make_statistics(state.gaussians.size(), training_->device);
  stepper_->prepare_appearance();
  const std::string warning = near_plane_warning(cloud.means, scene.train, config.near_plane);
  if (!warning.empty()) training_->recorder.warn(warning);
  if (scene.train.size() == 1) {
    training_->recorder.warn(
        "only one training view: other views will look wrong; a scene needs 20 photographs or more, each overlapping "
        "its neighbours");
  }
  if (config.max_gaussians > 0 && state.n_gaussians() > config.max_gaussians) {
    training_->recorder.warn(detail::concat("training starts with ", state.n_gaussians(),
                                            " Gaussians, more than --max_gaussians ", config.max_gaussians,
                                            "; none will be added"));
  }
}

std::vector<std::string> Trainer::resume(const std::filesystem::path& checkpoint) {
  TrainState& state = training_->state;
  Checkpoint read = read_checkpoint(checkpoint, training_->scene, stepper_->load_device());
  check_resume_options(read.config, read.state.iteration, training_->config, checkpoint.string());
  training_->fingerprint = scene_identity(*training_);
  const nlohmann::ordered_json header = read_checkpoint_header(checkpoint);
  const std::string n_views = std::to_string(training_->scene.train.size());
  for (const auto& [kind, list] :
       {std::pair{"", "photographs"}, {"masks of ", "masks"}, {"depth maps of ", "depth_maps"}}) {
    const std::vector<std::string> changed = changed_files(header, training_->fingerprint, list);
    if (changed.empty()) continue;
    training_->recorder.warn(detail::concat(
        kind, changed.size(), " of ", n_views, " photographs have changed since this checkpoint was written (",
        changed.size() > 1 ? "first: " : "", changed.front(), "); training continues with the current files"));
  }
  if (have_points_changed(header, training_->fingerprint)) {
    training_->recorder.warn(
        "the points of the scene have changed since this checkpoint was written; training continues "
        "with its Gaussians");
  }
  state = std::move(read.state);
  if (!training_->config.antialiasing) state.gaussians.filters = torch::Tensor();
  stepper_->adopt_model();
  stepper_->prepare_appearance();
  // Another strategy may record something else: it starts a new round of statistics.
  if (read.config.strategy != training_->config.strategy) {
    state.statistics = training_->density->make_statistics(state.gaussians.size(), training_->device);
  }
  resumed_ = checkpoint;
  training_->recorder.resume_from(checkpoint, state.elapsed_s);
  result_.first_iteration = state.iteration;
  training_->kernels.restore(state.kernel_selection, checkpoint.string());
  std::error_code error;  // ignored: then the folders differ
  if (std::filesystem::equivalent(read.config.model_path, training_->config.model_path, error)) {
    read.config.model_path = training_->config.model_path;  // the same folder, named in another way
  }
  changed_options_ = config_differences(read.config, training_->config);
  return changed_options_;
}

TrainResult Trainer::run(std::optional<int> until) {
  const TrainState& state = training_->state;
  const TrainConfig& config = training_->config;
  const int last = until.value_or(config.iterations);
  B3DGS_CHECK(last <= config.iterations, "iteration ", last, " of ", config.iterations);
  begin();
  while (state.iteration < last && !result_.interrupted) {
    try {
      run_iteration();
    } catch (const LossError&) {
      throw;
    } catch (...) {
      end_with_checkpoint();
    }
  }
  if (state.iteration == config.iterations && state.iteration > 0) stepper_->warn_of_empty_views();
  training_->time.finish_training();
  wait();
  training_->time.output([&] { training_->recorder.finish_files(); });
  static_cast<TrainOutputs&>(result_) = training_->recorder.outputs();
  result_.train_s = training_->time.train_s();
  result_.output_s = training_->time.output_s();
  result_.iteration = state.iteration;
  result_.n_gaussians = state.n_gaussians();
  result_.peak_memory_bytes = training_->memory->use().peak_reserved;
  result_.n_removed = state.n_removed;
  return result_;
}

void Trainer::step() {
  ensure_model();
  {
    const TimeAccount::TrainTime counted(training_->time);
    check_kernels();
    stepper_->step();
    density_control_->run();
  }
  training_->recorder.collect_stage_times();
}

void Trainer::wait() {
  stepper_->complete_pending();
  training_->recorder.wait_for_stage_times();
}

void Trainer::run_iteration() {
  const TrainConfig& config = training_->config;
  const TrainState& state = training_->state;
  TimeAccount& time = training_->time;
  TrainRecorder& recorder = training_->recorder;
  {
    const TimeAccount::TrainTime counted(time);
    check_kernels();
    stepper_->step();
    recorder.report_progress("training");
  }
  const bool is_last = state.iteration == config.iterations;
  const OutputPlan plan = output_plan(config, state.first_of_step(), state.iteration, !training_->scene.test.empty());
  const bool uses_device = plan.statistics || plan.kernel_times || plan.evaluate || plan.save;
  // Reading the loss waits for most of the step on a GPU.
  const bool ends = stepper_->must_stop();
  if (plan.log || uses_device || plan.checkpoint || ends) time.train([&] { stepper_->complete_pending(); });
  if (uses_device || plan.checkpoint || ends) time.train([&] { stepper_->flush(); });
  if (uses_device) {
    time.output([&] { write_outputs(plan); });
  } else if (plan.log) {
    // The device is still computing. Counting the line as output would mean waiting for the device, and would not count
    // the part of the step that runs meanwhile.
    time.train([&] { write_outputs(plan); });
  }
  if (is_last) {
    time.output([&] {
      stepper_->on_first([&] {
        if (training_->hooks.on_result) recorder.try_to_write(training_->hooks.on_result);
      });
    });
  }
  // If the last PLY could not be written, density control is left to the resumed training: it writes that PLY first.
  if (!is_last || stepper_->has_written_files()) time.train([&] { density_control_->run(); });
  if (training_->hooks.wants_model && stepper_->is_alone() && training_->hooks.wants_model()) show_model();
  result_.interrupted = !is_last && stepper_->must_stop();
  recorder.set_ending(result_.interrupted);
  if (plan.checkpoint || result_.interrupted || stepper_->is_checkpoint_due()) time.output([&] { write_state(); });
  if (result_.interrupted && !plan.save) time.output([&] { write_ply(); });
  // Of several processes, none holds the whole model on its device.
  if (is_last && stepper_->is_alone() && !training_->is_stopped()) time.output([&] { log_floaters(); });
  if (training_->hooks.wait_for_files) recorder.wait_for_files();
  recorder.collect_files();
}

void Trainer::check_kernels() {
  if (!stepper_->is_kernel_check_due()) return;
  const int iteration = training_->state.iteration + 1;
  stepper_->on_first([&] {
    training_->recorder.report_progress("checking kernels");
    for (const KernelCheck& check :
         training_->kernels.check(training_->check_moment(iteration), kernel_check_input())) {
      training_->recorder.log_event(iteration, "kernel_check", to_json(check));
      if (!check.message.empty()) training_->recorder.say(check.message);
    }
  });
  stepper_->share_kernels();
  training_->state.kernel_selection = training_->kernels.to_json();
}

void Trainer::show_model() {
  training_->time.train([&] {
    stepper_->complete_pending();
    stepper_->flush();
  });
  training_->time.output([&] {
    const TrainState& whole = stepper_->flushed_state();
    training_->hooks.on_model(
        {whole.iteration, whole.gaussians, whole.poses, whole.sh_degree, training_->kernels.forward_name()});
  });
}

Evaluation Trainer::evaluate(const std::vector<View>& views, const RenderedFn& on_rendered) {
  B3DGS_CHECK(has_begun_, "evaluate() before run()");
  Evaluation evaluation;
  stepper_->on_first([&] {
    evaluation = evaluate_here(with_refined_poses(views, training_->scene.train, training_->state.poses), on_rendered);
  });
  return evaluation;
}

std::filesystem::path Trainer::write_checkpoint() {
  B3DGS_CHECK(has_begun_, "write_checkpoint() before run()");
  TrainRecorder& recorder = training_->recorder;
  // Files that are still being written are those of a training that goes on.
  recorder.wait_for_files();
  recorder.collect_files();
  {
    const Ending ending(recorder);
    write_state();
  }
  const std::optional<WrittenFile> failed = recorder.take_failed_checkpoint();
  if (failed) throw IoError(failed->error + recorder.last_checkpoint());
  return recorder.outputs().checkpoint;
}

std::filesystem::path Trainer::save() {
  B3DGS_CHECK(stepper_->is_alone(), "save() of several processes");
  std::filesystem::path checkpoint = write_checkpoint();
  if (!std::filesystem::exists(training_->folder.ply(training_->state.iteration))) {
    const Ending ending(training_->recorder);
    write_ply();
  }
  return checkpoint;
}

std::string Trainer::describe_images() const {
  return "for training " + describe(training_->views.images.places()) + "; for testing " +
         describe(places_of(training_->scene.test));
}

std::optional<MemoryForecast> Trainer::forecast_memory() {
  const std::optional<std::int64_t> limit = training_->memory->limit();
  if (!limit) return std::nullopt;
  ensure_model();
  const GaussianMemory each = stepper_->memory_of_gaussian();
  const auto n = static_cast<double>(training_->state.gaussians.size());
  MemoryForecast forecast;
  forecast.limit = *limit;
  forecast.model = static_cast<std::int64_t>(n * (each.state + each.step));
  forecast.pairs = static_cast<std::int64_t>(n * each.view);
  forecast.photographs = std::max<std::int64_t>(0, training_->memory->use().in_use - state_bytes(training_->state));
  forecast.images = stepper_->memory_of_images();
  forecast.largest_count = largest_count(*limit, forecast.photographs + forecast.images, each);
  return forecast;
}

// --- Failures ---

std::string Trainer::save_last_state() {
  const int iteration = training_->state.iteration;
  if (!stepper_->can_save()) return stepper_->last_checkpoint();
  if (iteration == 0) return "";
  stepper_->complete_pending();
  if (!training_->is_consistent) return stepper_->last_checkpoint();
  training_->free_scratch()();
  training_->recorder.set_ending(true);
  write_state();
  if (!stepper_->has_written_files()) {
    const std::vector<WrittenFile>& failed = training_->recorder.failed_files();
    return kNoCheckpoint + (failed.empty() ? "see rank 0" : failed.back().error) + stepper_->last_checkpoint();
  }
  return detail::concat("; iteration ", iteration, " is saved, ",
                        training_->resume_words(training_->folder.checkpoint(iteration)));
}

void Trainer::end_with_checkpoint() {
  const std::exception_ptr cause = std::current_exception();
  std::string saved;
  try {
    saved = save_last_state();
  } catch (const LossError&) {
    throw;
  } catch (const std::exception& error) {
    saved = kNoCheckpoint + first_line(error.what()) + stepper_->last_checkpoint();
  }
  try {
    std::rethrow_exception(cause);
  } catch (const std::exception& error) {
    if (is_out_of_memory(error)) {
      throw OutOfMemoryError(detail::concat("out of memory after iteration ", training_->state.iteration, ", with ",
                                            training_->state.n_gaussians(), " Gaussians", saved));
    }
    if (const auto* const known = dynamic_cast<const Error*>(&error)) known->rethrow_with(saved);
    throw Error(first_line(error.what()) + saved);
  }
}

}  // namespace b3dgs
