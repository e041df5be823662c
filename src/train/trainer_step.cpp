// A step, in order: rates and SH degree, view, render, loss, gradients, Adam; then what is measured and saved; then
// density control; then the checkpoint.
//
// The original differs in two places. It runs density control before Adam, and since that replaces the parameters, the
// gradients of such a step are lost; here they are used. And it leaves out Adam in the very last iteration; here every
// iteration is alike, so that a run that is resumed to go further is the same as one that never stopped. Either is one
// step in a hundred or fewer. What it measures and saves at an iteration is the model before
// that iteration's density control, as here: an opacity reset would otherwise be seen in the figures.

#include <cmath>

#include "core/random.h"
#include "train/density/original_strategy.h"
#include "train/gaussians/gaussian_model.h"
#include "train/gaussians/initial_splats.h"
#include "train/optimizer/lr_schedule.h"
#include "train/trainer_impl.h"

namespace b3dgs {

void Trainer::Impl::start() {
  const SplatCloud cloud = initial_splats(config, scene);
  state.sh_degree = std::min(cloud.sh_degree, config.sh_degree);
  state.gaussians = to_tensors(cloud, config.sh_degree, device);
  state.adam = make_adam_state(state.gaussians);
  state.statistics = make_density_statistics(state.gaussians.size(), device);
  if (config.max_gaussians > 0 && state.gaussians.size() > config.max_gaussians) {
    warn(detail::concat("training starts with ", state.gaussians.size(), " Gaussians, more than --max_gaussians ",
                        config.max_gaussians, ": none are added"));
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
  if (!std::isfinite(value)) {
    throw LossError(
        detail::concat("iteration ", iteration, ", view ", view, ": the loss is ", value, last_checkpoint()));
  }
  state.loss_average = iteration == 1 ? value : 0.4 * value + 0.6 * state.loss_average;
}

/// A step of the Gaussians along the gradients of one view; statistics for density control.
void Trainer::Impl::learn(const TrainView& view) {
  RenderedView rendered;
  try {
    const RenderSettings settings = step_settings();
    // The backward pass asks for nothing that this has not taken already.
    rendered = with_remedies({wait_for_files(), free_scratch(), release_photographs()},
                             [&] { return stepper.forward(state.gaussians, state.adam, view.camera, settings); });
  } catch (const BadGaussianError&) {
    throw;
  } catch (const NumericError& error) {
    throw NumericError(detail::concat("iteration ", state.iteration, ", view ", view.name, ": ", error.what()));
  }
  view_ratios.add(rasterizer.view_size(), state.gaussians.size());
  if (const std::int64_t bytes = rasterizer.memory_bytes(); bytes != std::exchange(view_bytes, bytes)) trim_memory();
  settle_loss();  // of the step before: the device has finished it by now
  step_start.loss_average = state.loss_average;
  timer.begin(Stage::kLoss);
  loss.compute(rendered.color, view.truth, view.valid, view.n_valid, config.lambda_dssim);
  timer.end();
  unsettled = {state.iteration, view.name};
  if (device.is_cpu()) settle_loss();
  const ViewStatistics statistics = stepper.step(adam_rates(config, scene.extent, state.iteration),
                                                 {loss.grad(), {}, {}}, state.gaussians, state.adam, &timer);
  if (density_plan(config, state.iteration).add_statistics) {
    timer.begin(Stage::kDensify);
    add_view(statistics, view.camera.width, view.camera.height, state.statistics);
    timer.end();
  }
}

double Trainer::Impl::step_ms() const {
  if (logged_ms > 0 || state.iteration == 0) return logged_ms;
  return 1e3 * elapsed_s() / state.iteration;
}

/// The views that come next, and the model as it stands.
BlendInput Trainer::Impl::kernel_check_input() {
  BlendInput input{rasterizer, settled().gaussians, evaluation_settings(config, state.sh_degree), {}};
  for (const std::int32_t view :
       state.view_order.upcoming(config.seed, images.size(), static_cast<std::size_t>(config.kernel_check_views))) {
    input.views.push_back(images.describe(view).camera);
  }
  return input;
}

/// Measures the blending kernels before the step of `iteration`, if that is due. Nothing of the training changes.
void Trainer::Impl::check_kernels(int iteration) {
  CheckMoment now{iteration, config.iterations - state.iteration, step_ms()};
  if (!kernels.is_due(now)) return;
  now.is_after_reset = is_after_opacity_reset(config, iteration);
  if (!kernels.is_due(now)) return;
  report("checking kernels");
  for (const KernelCheck& check : kernels.check(now, kernel_check_input())) {
    if (log) log->write_event(iteration, "kernel_check", to_json(check));
    if (!check.message.empty()) say(check.message);
  }
  state.kernel_selection = kernels.to_json();
}

void Trainer::Impl::take_step() {
  // Steps are alike for a while: one in a hundred says how long the stages take. Not a round one: a new row count, and
  // with it new memory, comes after those.
  constexpr int kTimedInterval = 100, kTimedPhase = 50;
  const int iteration = state.iteration + 1;
  if (hooks.on_stage_times || iteration % kTimedInterval == kTimedPhase) timer.start(StageTimes::Kind::kStep);
  timer.begin(Stage::kUpload);
  const std::vector<std::int32_t> next = state.view_order.upcoming(config.seed, images.size(), 1 + images.look_ahead());
  const TrainView view = images.take(next.front(), {next.begin() + 1, next.end()});
  timer.end();
  // Only now: a photograph that cannot be read leaves the state as it was after the last step.
  state.iteration = iteration;
  state.view_order.next(config.seed, images.size());
  if (iteration % config.sh_increase_interval == 0) state.sh_degree = std::min(state.sh_degree + 1, config.sh_degree);
  learn(view);
  timer.finish();
}

void Trainer::Impl::control_density() {
  const DensityPlan plan = density_plan(config, state.iteration);
  if (plan.densify) {
    report("densifying");
    timer.start(StageTimes::Kind::kDensityRound);
    settle();
    grow();
    timer.finish();
    if (state.gaussians.size() == 0) {
      is_whole = false;
      throw NumericError(detail::concat("iteration ", state.iteration, ": density control removed the last Gaussian; ",
                                        "lower --prune_opacity or the learning rates"));
    }
  }
  if (plan.reset_opacities) reset_opacities(state.gaussians, state.adam);
  state.is_density_pending = false;
}

}  // namespace b3dgs
