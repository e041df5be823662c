// One step: view, SH degree, forward pass, loss, backward pass with Adam, density statistics.
//
// Two things differ from the original 3DGS. There, density control runs before Adam and replaces the
// parameter tensors, so Adam has no gradients in such a step. Here Adam comes first and uses them. The original also
// skips Adam in the very last iteration. Here all iterations are alike, so that a training resumed with more iterations
// equals one that never stopped. Each difference affects at most one step in a hundred. As in the original, the
// evaluation and PLY of an iteration show the model before that iteration's density control. Otherwise they would show
// a model right after an opacity reset.
#include "train/step.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>

#include "config/batch_steps.h"
#include "config/coarse_schedule.h"
#include "core/random.h"
#include "raster/checks.h"
#include "train/evaluate.h"
#include "train/optimizer/adam.h"

namespace b3dgs {
namespace {

TrainView next_view(Training& training) {
  TrainState& state = training.state;
  training.timer.begin(Stage::kUpload);
  ++state.iteration;
  const std::int32_t index = state.view_order.next(training.config.seed, training.views.size());
  TrainView view = training.views.take(
      index, state.iteration, training.views.upcoming(state.view_order, training.views.images.n_upcoming_wanted()));
  training.timer.end();
  return view;
}

void add_statistics(Training& training, const DensityPlan& plan, const TrainView& view, int iteration,
                    const ViewStatistics& statistics) {
  if (!plan.statistics) return;
  training.timer.begin(Stage::kDensify);
  DensityView seen{iteration, statistics, view.camera.width, view.camera.height};
  if (plan.score) {
    seen.add_scores = [&](const GaussianScores& scores) {
      training.rasterizer.score(training.objective.errors(), scores);
    };
  }
  training.density->after_view(seen, training.state.statistics);
  training.timer.end();
}

}  // namespace

StepOutcome take_step(Training& training, LastStep& before) {
  const TrainConfig& config = training.config;
  TrainState& state = training.state;
  GaussianOptimizer& optimizer = training.optimizer;
  const bool is_kept = keeps_gradients(training);
  const int last_iteration = step_end(config.batch, config.iterations, state.iteration);
  StepOutcome outcome;
  begin_step(training, last_iteration);
  while (state.iteration < last_iteration) {
    const TrainView view = next_view(training);
    const int iteration = state.iteration;
    const DensityPlan plan = training.density->plan(iteration);
    decide_kernel(training, iteration);
    RenderSettings settings = step_settings(training, iteration);
    settings.camera_gradient = training.views.poses.refines(view.index, iteration);
    const RenderedView rendered = name_view_in_errors(view, iteration, [&] {
      // On a GPU, forward() then also applies deferred updates, with DeferredSh as the ColorPass.
      settings = optimizer.begin_view(state.gaussians, state.adam, training.kernels.begin_view(iteration, settings));
      return training.rasterizer.forward(state.gaussians, view.camera, settings);
    });
    if (is_kept) optimizer.make_room_for_view(state.gaussians);
    trim_after_view(training);
    outcome.sizes.push_back(full_size_of_view(training, iteration));

    // By now the device has finished the previous view, so reading its loss costs little.
    training.views.poses.take_queued_steps();
    read_losses(training, before, before.unread_losses);
    read_losses(training, before, outcome.unread_losses);

    if (AppearanceModel* const appearance = training.objective.appearance()) {
      appearance->set_place(static_cast<int>(outcome.views.size()));
    }
    const RenderedViewGrad grad = loss_gradient(training, view, iteration, rendered, plan.score);
    outcome.views.push_back({view.index, iteration, outcome.sizes.back().n_pairs == 0});
    outcome.unread_losses = {outcome.views.back()};
    if (training.device.is_cpu()) read_losses(training, before, outcome.unread_losses);

    const RegularizationWeights weights = regularization(training, before);
    const ViewStatistics statistics =
        is_kept ? optimizer.backward_and_keep(view.camera, settings, grad, state.gaussians, weights)
                : optimizer.backward_and_step(adam_rates(config, training.scene.extent, iteration), grad,
                                              state.gaussians, state.adam, &training.timer, weights);
    if (settings.camera_gradient) training.views.poses.add_gradient(view.index, iteration, statistics.camera_grad);
    add_statistics(training, plan, view, iteration, statistics);
  }
  finish_step(training, outcome.views);
  return outcome;
}

void begin_step(Training& training, int last_iteration) {
  const TrainConfig& config = training.config;
  TrainState& state = training.state;
  const int from = state.iteration;
  // Returns whether the step has an iteration k with k % interval == phase.
  const auto has_multiple = [&](int interval, int phase) {
    return (last_iteration - phase + interval) / interval > (from - phase + interval) / interval;
  };
  // One step in a hundred is timed, because consecutive steps are similar. It is not at a multiple of 100, where
  // density control may change the number of Gaussians so that the next step reallocates. Filters are updated as
  // rarely, because the means that they depend on move slowly.
  constexpr int kInterval = 100, kTimedPhase = 50, kFilterPhase = 1;
  if (training.hooks.on_stage_times || has_multiple(kInterval, kTimedPhase)) {
    training.timer.start(StageTimes::Kind::kStep);
  }
  state.step_iterations = last_iteration - from;
  state.sh_degree =
      std::min(state.sh_degree + last_iteration / config.sh_increase_interval - from / config.sh_increase_interval,
               config.sh_degree);
  training.update_filters(has_multiple(kInterval, kFilterPhase));
}

RenderSettings step_settings(Training& training, int iteration) {
  const TrainConfig& config = training.config;
  RenderSettings settings = base_render_settings(config, training.state.sh_degree);
  settings.kernel = kernel_named(training.kernels.kernel());
  settings.stages = &training.timer;
  settings.inverse_depth = settings.depth_gradient = training.objective.has_depths();
  if (config.random_background) {
    const auto color =
        random_uniform({config.seed, RandomStream::kBackground, static_cast<std::uint32_t>(iteration)}, 0);
    settings.background = {color[0], color[1], color[2]};
  }
  return settings;
}

void decide_kernel(Training& training, int iteration) {
  const bool is_over = iteration > training.config.iterations;
  const std::optional<KernelDecision> check =
      is_over ? training.kernels.finish(iteration) : training.kernels.decide(iteration);
  if (!check) return;
  training.state.kernel_selection = training.kernels.to_json();
  training.recorder.log_event(iteration, "kernel_check", to_json(*check));
  if (!check->message.empty()) training.recorder.say(check->message);
}

RenderedView name_view_in_errors(const TrainView& view, int iteration, const std::function<RenderedView()>& render) {
  try {
    return render();
  } catch (const InvalidGaussianError&) {
    throw;
  } catch (const NumericError& error) {
    throw NumericError(detail::concat("iteration ", iteration, ", view ", view.name, ": ", error.what()));
  }
}

void trim_after_view(Training& training) {
  const std::int64_t bytes = training.rasterizer.memory_bytes();
  if (bytes != std::exchange(training.view_bytes, bytes)) training.trim_memory();
}

ViewSize full_size_of_view(const Training& training, int iteration) {
  ViewSize size = training.rasterizer.view_size();
  // At full size, a splat touches at most scale^2 times as many tiles.
  const std::int64_t scale = coarse_scale_at(training.config, iteration);
  size.n_pairs *= scale * scale;
  return size;
}

RenderedViewGrad loss_gradient(Training& training, const TrainView& view, int iteration, const RenderedView& rendered,
                               bool wants_errors) {
  training.timer.begin(Stage::kLoss);
  const RenderedViewGrad grad =
      training.objective.gradient(view, iteration, training.views.images.stored_view(view.index).valid, rendered,
                                  wants_errors, training.state.appearance);
  training.timer.end();
  return grad;
}

RegularizationWeights regularization(const Training& training, const LastStep& before) {
  return regularization_weights(training.config, training.scene.extent,
                                before.position.iteration > 0 ? before.position.loss_average : kRegularizedLoss);
}

void finish_step(Training& training, const std::vector<StepView>& views, const torch::Tensor& model_rows) {
  TrainState& state = training.state;
  if (training.optimizer.n_kept_views() > 0) {  // otherwise backward_and_step() has taken the step
    training.optimizer.step_views(adam_rates(training.config, training.scene.extent, state.iteration), state.gaussians,
                                  state.adam, &training.timer);
  }
  training.views.poses.queue_step();
  if (training.device.is_cpu()) training.views.poses.take_queued_steps();
  // Each photograph's appearance takes one Adam step.
  if (AppearanceModel* const appearance = training.objective.appearance()) {
    training.timer.begin(Stage::kOptimizer);
    for (std::size_t place = 0; place < views.size(); ++place) {
      const StepView& view = views[place];
      appearance->set_place(static_cast<int>(place));
      // The gradient of the first view was taken with its updates applied; the steps before this one moved the others.
      if (place > 0) appearance->begin_step(view.index, view.iteration, state.appearance);
      appearance->step(view.index, view.iteration, state.appearance);
    }
    training.timer.end();
  }
  for (const StepView& view : views) {
    if (!training.density->plan(view.iteration).after_step) continue;
    training.timer.begin(Stage::kDensify);
    training.density->after_step(view.iteration, state.gaussians, model_rows);
    training.timer.end();
  }
  training.timer.finish(state.step_iterations);
}

bool keeps_gradients(const Training& training) {
  const TrainConfig& config = training.config;
  return !training.state.is_whole() || config.batch > 1 || (config.deterministic && !training.device.is_cpu());
}

void read_losses(Training& training, LastStep& before, std::vector<StepView>& unread) {
  for (const StepView& view : std::exchange(unread, {})) {
    add_loss(training, before, view, training.objective.value());
  }
}

void add_loss(Training& training, LastStep& before, const StepView& view, double value) {
  if (!std::isfinite(value)) {
    throw LossError(detail::concat("iteration ", view.iteration, ", view ",
                                   training.scene.train[static_cast<std::size_t>(view.index)].name, ": the loss is ",
                                   value, training.last_checkpoint()));
  }
  double& average = training.state.loss_average;
  average = view.iteration == 1 ? value : 0.4 * value + 0.6 * average;
  // A roll-back to the last step must not undo this.
  if (view.iteration <= before.position.iteration) before.position.loss_average = average;
}

}  // namespace b3dgs
