// A step, in order: rates and SH degree, view, render, loss, gradients, Adam; then what is measured and saved; then
// density control; then the checkpoint.
//
// The original differs in two places. It runs density control before Adam, and since that replaces the parameters, the
// gradients of such a step are lost; here they are used. And it leaves out Adam in the very last iteration; here every
// iteration is alike, so that a run that is resumed to go further is the same as one that never stopped. Either is one
// step in a hundred or fewer. What it measures and saves at an iteration is the model before
// that iteration's density control, as here: an opacity reset would otherwise be seen in the figures.

#include "train/trainer.h"

#include <torch/cuda.h>

#include <chrono>
#include <cmath>
#include <cstdio>
#include <optional>
#include <utility>

#include "check.h"
#include "scene/ply.h"
#include "train/checkpoint.h"
#include "train/densifier.h"
#include "train/gaussian_model.h"
#include "train/image_store.h"
#include "train/initial_splats.h"
#include "train/kernel_check.h"
#include "train/loss.h"
#include "train/lr_schedule.h"
#include "train/output_plan.h"
#include "train/random.h"
#include "train/stage_timer.h"
#include "train/threads.h"
#include "train/train_log.h"
#include "train/train_state.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

double seconds_since(std::chrono::steady_clock::time_point start) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

}  // namespace

struct Trainer::Impl {
  Impl(const TrainConfig& config, const Scene& scene, ModelFolder folder, TrainHooks hooks)
      : config(config),
        scene(scene),
        folder(std::move(folder)),
        hooks(std::move(hooks)),
        device(config.device == "cuda" ? torch::Device(torch::kCUDA, 0) : torch::Device(torch::kCPU)),
        rasterizer(device),
        loss(device),
        kernels(config, device),
        images(scene.train, device, image_budget(config.image_cache_gb, device)),
        timer(make_stage_clock(device)) {
    if (device.is_cuda() && config.deterministic &&
        evaluation_settings(config, 0).backward_kernel != BackwardKernel::kPerSplat) {
      input_error("--deterministic: the backward kernel ", config.backward_kernel,
                  " adds up in an order that changes from run to run; use --backward_kernel per-splat");
    }
    if (images.size() == 0) input_error(scene.source_path, ": has no view to train on");
  }

  void start();
  void begin();
  void check_kernels(int iteration);
  void step();
  void settle_loss();
  [[noreturn]] void fail(int iteration, const std::string& view, const std::string& reason) const;
  void differentiate(const TrainView& view);
  void control_density();
  void collect_times(const std::vector<StageTimes>& known);
  void log_load();
  void write_outputs(const OutputPlan& plan);
  void write_checkpoint();
  void report(const char* activity) const;
  void say(const std::string& message) const {
    if (hooks.on_message) hooks.on_message(message);
  }
  RenderSettings step_settings();
  /// Counts what `work` takes as time of training.
  template <class Work>
  void timed(Work&& work) {
    const auto start = std::chrono::steady_clock::now();
    work();
    const double seconds = seconds_since(start);
    result.train_s += seconds;
    state.elapsed_s += seconds;
  }
  bool is_stopped() const { return hooks.stop_signal && hooks.stop_signal->load() != 0; }

  const TrainConfig config;
  const Scene& scene;
  const ModelFolder folder;
  const TrainHooks hooks;
  const torch::Device device;

  Rasterizer rasterizer;
  ImageLoss loss;
  KernelChecks kernels;
  ImageStore images;
  StageTimer timer;
  StageAverage stages;
  GaussianTensors grads;
  TrainState state;
  TrainResult result;
  /// A step whose loss the host has not read yet.
  struct Unsettled {
    int iteration = 0;
    std::string view;
  };
  std::optional<Unsettled> unsettled;
  std::unique_ptr<TrainLog> log;
  int logged_iteration = 0;  // of the last line
  double logged_s = 0;       // result.train_s at the last line
  int staged_iteration = 0;  // of the last line with times of the stages
};

void Trainer::Impl::start() {
  const SplatCloud cloud = initial_splats(config, scene);
  state.sh_degree = std::min(cloud.sh_degree, config.sh_degree);
  state.gaussians = to_tensors(cloud, config.sh_degree, device);
  state.adam = make_adam_state(state.gaussians);
  state.statistics = make_density_statistics(state.gaussians.size(), device);
  if (config.max_gaussians > 0 && state.gaussians.size() > config.max_gaussians) {
    say(detail::concat("training starts with ", state.gaussians.size(), " Gaussians, more than --max_gaussians ",
                       config.max_gaussians, ": none are added"));
  }
}

/// What has to be there before the first step of this session; nothing when called again.
void Trainer::Impl::begin() {
  if (log) return;
  if (state.gaussians.size() == 0) start();
  folder.write_inputs(config, scene);
  log = std::make_unique<TrainLog>(folder.log(), state.iteration);
  logged_iteration = staged_iteration = state.iteration;
  if (state.iteration == config.iterations) {
    say(detail::concat("all ", config.iterations, " iterations are done; more need a larger --iterations"));
    result.ply = folder.ply(state.iteration);
  }
}

RenderSettings Trainer::Impl::step_settings() {
  RenderSettings settings = kernels.apply(evaluation_settings(config, state.sh_degree));
  settings.stages = &timer;
  if (config.random_background) {
    const auto color =
        random_uniform({config.seed, RandomStream::kBackground, static_cast<std::uint32_t>(state.iteration)}, 0);
    settings.background = {color[0], color[1], color[2]};
  }
  return settings;
}

void Trainer::Impl::settle_loss() {
  if (!unsettled) return;
  const auto [iteration, view] = *std::exchange(unsettled, std::nullopt);
  const double value = loss.value().loss;
  if (!std::isfinite(value)) fail(iteration, view, detail::concat("the loss is ", value));
  state.loss_average = iteration == 1 ? value : 0.4 * value + 0.6 * state.loss_average;
}

void Trainer::Impl::fail(int iteration, const std::string& view, const std::string& reason) const {
  const std::string last = result.checkpoint.empty() ? "none was written" : result.checkpoint.string();
  throw NumericError(
      detail::concat("iteration ", iteration, ", view ", view, ": ", reason, "; last checkpoint: ", last));
}

/// Loss and gradients of one view; statistics for density control.
void Trainer::Impl::differentiate(const TrainView& view) {
  RenderedView rendered;
  try {
    rendered = rasterizer.forward(state.gaussians, view.camera, step_settings());
  } catch (const NumericError& error) {
    fail(state.iteration, view.name, error.what());
  }
  settle_loss();  // of the step before: the device has finished it by now
  timer.begin(Stage::kLoss);
  loss.compute(rendered.color, view.truth, view.valid, view.n_valid, config.lambda_dssim);
  timer.end();
  unsettled = {state.iteration, view.name};
  if (device.is_cpu()) settle_loss();
  const ViewStatistics statistics = rasterizer.backward(state.gaussians, {loss.grad(), {}, {}}, grads);
  if (density_plan(config, state.iteration).add_statistics) {
    timer.begin(Stage::kDensify);
    add_view(statistics, view.camera.width, view.camera.height, state.statistics);
    timer.end();
  }
}

/// Measures the blending kernels before the step of `iteration`, if that is due. Nothing of the training changes.
void Trainer::Impl::check_kernels(int iteration) {
  if (!kernels.is_due(iteration)) return;
  std::vector<PinholeView> coming;
  for (const std::int32_t view :
       state.view_order.upcoming(config.seed, images.size(), static_cast<std::size_t>(config.kernel_check_views))) {
    coming.push_back(images.describe(view).camera);
  }
  const int n_steps = state.iteration - logged_iteration;  // since the last line of the log
  const double step_ms = n_steps > 0 ? 1e3 * (result.train_s - logged_s) / n_steps : 0;
  for (const KernelCheck& check : kernels.check(
           iteration, {rasterizer, state.gaussians, evaluation_settings(config, state.sh_degree), coming, step_ms})) {
    if (log) log->write_event(iteration, "kernel_check", to_json(check));
    if (!check.message.empty()) say(check.message);
  }
  state.kernel_selection = kernels.to_json();
}

/// How uneven the load of the first view is: always the same one, so that only the training makes a difference.
void Trainer::Impl::log_load() {
  const TrainView& view = images.describe(0);
  RenderSettings settings = evaluation_settings(config, state.sh_degree);
  settings.keep_for_backward = false;
  try {
    rasterizer.forward(state.gaussians, view.camera, settings);
  } catch (const NumericError& error) {
    fail(state.iteration, view.name, error.what());
  }
  log->write_event(state.iteration, "load_statistics", load_json(view.name, rasterizer.count_load()));
}

void Trainer::Impl::step() {
  check_kernels(state.iteration + 1);
  // Steps are alike for a while: one in a hundred says how long the stages take. Not a round one: a new row count, and
  // with it new memory, comes after those.
  constexpr int kTimedInterval = 100, kTimedPhase = 50;
  const int iteration = ++state.iteration;
  if (hooks.on_stage_times || iteration % kTimedInterval == kTimedPhase) timer.start(StageTimes::Kind::kStep);
  if (iteration % config.sh_increase_interval == 0) state.sh_degree = std::min(state.sh_degree + 1, config.sh_degree);
  timer.begin(Stage::kUpload);
  const std::int32_t index = state.view_order.next(config.seed, images.size());
  const TrainView view =
      images.take(index, state.view_order.upcoming(config.seed, images.size(), ImageStore::kLookAhead));
  timer.end();
  differentiate(view);
  timer.begin(Stage::kOptimizer);
  adam_step(adam_rates(config, scene.extent, iteration), grads, state.gaussians, state.adam);
  timer.finish();
}

void Trainer::Impl::control_density() {
  const DensityPlan plan = density_plan(config, state.iteration);
  if (plan.densify) {
    report("densifying");
    timer.start(StageTimes::Kind::kDensityRound);
    const DensityRound round =
        densify(state.gaussians, state.statistics, density_rule(config, scene.extent, state.iteration), config.seed,
                state.iteration);
    apply_row_edit(round.edit, state.gaussians, state.adam, state.statistics);
    state.statistics = make_density_statistics(state.gaussians.size(), device);
    timer.finish();
    if (state.gaussians.size() == 0) {
      throw NumericError(detail::concat("iteration ", state.iteration, ": density control removed the last Gaussian; ",
                                        "lower --prune_opacity or the learning rates"));
    }
  }
  if (plan.reset_opacities) reset_opacities(state.gaussians, state.adam);
}

void Trainer::Impl::collect_times(const std::vector<StageTimes>& known) {
  for (const StageTimes& times : known) {
    stages.add(times);
    if (hooks.on_stage_times) hooks.on_stage_times(times);
  }
}

void Trainer::Impl::write_outputs(const OutputPlan& plan) {
  if (plan.statistics) log_load();
  TrainLogLine line;
  if (plan.evaluate) {
    report("evaluating");
    result.evaluations.emplace_back(state.iteration, evaluate_views(rasterizer, state.gaussians, scene.test,
                                                                    evaluation_settings(config, state.sh_degree)));
    const Evaluation& evaluation = result.evaluations.back().second;
    folder.write_results(state.iteration, evaluation);
    line.test_quality = evaluation.mean;
    char text[120];
    std::snprintf(text, sizeof text, "iteration %d: PSNR %.2f dB, SSIM %.4f on %zu test views", state.iteration,
                  evaluation.mean.psnr, evaluation.mean.ssim, evaluation.views.size());
    say(text);
  }
  if (plan.log) {
    line.iteration = state.iteration;
    line.loss = state.loss_average;
    line.ms = 1e3 * (result.train_s - logged_s) / std::max(1, state.iteration - logged_iteration);
    line.count = state.gaussians.size();
    line.elapsed_s = state.elapsed_s;
    collect_times(timer.take());
    line.stages = stages.take(state.iteration - staged_iteration);
    if (line.stages) staged_iteration = state.iteration;
    line.kernel = kernels.forward_name();
    line.backward_kernel = kernels.backward_name();
    log->write(line);
    logged_iteration = state.iteration;
    logged_s = result.train_s;
  }
  if (plan.save) {
    report("saving");
    result.ply = folder.ply(state.iteration);
    write_splat_ply(result.ply, to_splat_cloud(state.gaussians));
  }
}

void Trainer::Impl::write_checkpoint() {
  report("checkpoint");
  settle_loss();
  const fs::path path = folder.checkpoint(state.iteration);
  b3dgs::write_checkpoint(path, config, state, scene);
  result.checkpoint = path;
  remove_superseded_checkpoints(folder, state.iteration, config.keep_checkpoints);
}

void Trainer::Impl::report(const char* activity) const {
  if (!hooks.on_progress) return;
  TrainProgress progress;
  progress.iteration = state.iteration;
  progress.iterations = config.iterations;
  progress.loss = state.loss_average;
  progress.n_gaussians = state.gaussians.size();
  progress.elapsed_s = result.train_s;
  progress.activity = activity;
  hooks.on_progress(progress);
}

Trainer::Trainer(const TrainConfig& config, const Scene& scene, ModelFolder folder, TrainHooks hooks) {
  set_compute_threads(config.threads);
  impl_ = std::make_unique<Impl>(config, scene, std::move(folder), std::move(hooks));
}
Trainer::~Trainer() = default;

std::vector<std::string> Trainer::resume(const fs::path& checkpoint) {
  Impl& own = *impl_;
  Checkpoint read = read_checkpoint(checkpoint, own.scene, own.device);
  if (read.config.sh_degree != own.config.sh_degree) {
    input_error(checkpoint.string(), ": holds a model of SH degree ", read.config.sh_degree, ", --sh_degree is ",
                own.config.sh_degree, "; resume with the same degree");
  }
  if (read.state.iteration > own.config.iterations) {
    input_error(checkpoint.string(), ": is at iteration ", read.state.iteration, ", beyond --iterations ",
                own.config.iterations, "; give a larger number");
  }
  own.state = std::move(read.state);
  own.result.checkpoint = checkpoint;
  own.kernels.restore(own.state.kernel_selection, checkpoint.string());
  return config_differences(read.config, own.config);
}

void Trainer::step() {
  Impl& own = *impl_;
  if (own.state.gaussians.size() == 0) own.start();
  own.timed([&] { own.step(); });
  own.timed([&] { own.control_density(); });
  own.collect_times(own.timer.take());
}

void Trainer::wait() {
  impl_->settle_loss();
  impl_->collect_times(impl_->timer.wait());
}

std::int64_t Trainer::n_gaussians() const {
  return impl_->state.gaussians.size();
}

int Trainer::sh_degree() const {
  return impl_->state.sh_degree;
}

TrainResult Trainer::run() {
  return run_until(impl_->config.iterations);
}

TrainResult Trainer::run_until(int iteration) {
  Impl& own = *impl_;
  TrainResult& result = own.result;
  B3DGS_CHECK(iteration <= own.config.iterations, "iteration ", iteration, " of ", own.config.iterations);
  own.begin();
  while (own.state.iteration < iteration && !result.interrupted) {
    own.timed([&] { own.step(); });
    own.report("training");
    const OutputPlan plan = output_plan(own.config, own.state.iteration, !own.scene.test.empty());
    if (plan.log || plan.statistics || plan.evaluate || plan.save || plan.checkpoint || own.is_stopped())
      own.settle_loss();
    auto start = std::chrono::steady_clock::now();
    own.write_outputs(plan);
    result.output_s += seconds_since(start);
    own.timed([&] { own.control_density(); });
    start = std::chrono::steady_clock::now();
    result.interrupted = own.state.iteration < own.config.iterations && own.is_stopped();
    if (plan.checkpoint || result.interrupted) own.write_checkpoint();
    result.output_s += seconds_since(start);
  }
  if (own.device.is_cuda()) own.timed([] { torch::cuda::synchronize(); });
  wait();
  result.iteration = own.state.iteration;
  result.n_gaussians = own.state.gaussians.size();
  return result;
}

int Trainer::iteration() const {
  return impl_->state.iteration;
}

Evaluation Trainer::evaluate(const std::vector<View>& views, const RenderedFn& on_rendered) {
  Impl& own = *impl_;
  B3DGS_CHECK(own.log, "the training has not begun");
  return evaluate_views(own.rasterizer, own.state.gaussians, views,
                        evaluation_settings(own.config, own.state.sh_degree), on_rendered);
}

fs::path Trainer::write_checkpoint() {
  B3DGS_CHECK(impl_->log, "the training has not begun");
  impl_->write_checkpoint();
  return impl_->result.checkpoint;
}

}  // namespace b3dgs
