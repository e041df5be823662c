// One step: view, SH degree, forward pass, loss, backward pass with Adam, density statistics.
//
// The original 3DGS differs in two places. It runs density control before Adam; that replaces the parameters, so the
// gradients of such a step are lost. Here they are used. And it skips Adam in the very last iteration; here all
// iterations are alike, so that a training resumed with more iterations equals one that never stopped. Each affects
// at most one step in a hundred. As in the original, an iteration's evaluation and PLY show the model before that
// iteration's density control; otherwise an opacity reset would show in the figures.

#include <algorithm>
#include <cmath>

#include "config/coarse_schedule.h"
#include "core/random.h"
#include "train/gaussians/gaussian_model.h"
#include "train/gaussians/initial_splats.h"
#include "train/loss/loss_weights.h"
#include "train/optimizer/lr_schedule.h"
#include "train/scene_limits.h"
#include "train/trainer_impl.h"

namespace b3dgs {

void Trainer::Impl::initialize_model() {
  const SplatCloud cloud = initial_splats(config, scene);
  if (cloud.antialiased && !config.antialiasing) {
    recorder.warn(config.init_ply + " was trained with --antialiasing, but this training renders without it: splats " +
                  "that are small in the image become too opaque; add --antialiasing");
  }
  state.sh_degree = std::min(cloud.sh_degree, config.sh_degree);
  // Of several ranks, none holds the whole model on its GPU.
  state.gaussians = to_tensors(cloud, config.sh_degree, is_distributed() ? torch::Device(torch::kCPU) : device);
  if (is_distributed()) keep_own_rows();
  state.adam = make_adam_state(state.gaussians);
  state.statistics = density->make_statistics(state.gaussians.size(), device);
  prepare_appearance();
  const std::string warning = near_plane_warning(cloud.means, scene.train, config.near_plane);
  if (!warning.empty()) recorder.warn(warning);
  if (scene.train.size() == 1) {
    recorder.warn(
        "only one training view: other views will look wrong; a scene needs 20 photographs or more, each overlapping "
        "its neighbours");
  }
  if (config.max_gaussians > 0 && state.n_gaussians() > config.max_gaussians) {
    recorder.warn(detail::concat("training starts with ", state.n_gaussians(), " Gaussians, more than --max_gaussians ",
                                 config.max_gaussians, "; none will be added"));
  }
}

RenderSettings Trainer::Impl::step_settings() {
  RenderSettings settings = kernels.apply(evaluation_settings(config, state.sh_degree));
  settings.stages = &timer;
  settings.inverse_depth = settings.depth_gradient = depth_priors.has_value();
  if (config.random_background) {
    const auto color =
        random_uniform({config.seed, RandomStream::kBackground, static_cast<std::uint32_t>(state.iteration)}, 0);
    settings.background = {color[0], color[1], color[2]};
  }
  return settings;
}

void Trainer::Impl::read_loss() {
  poses.finish_step();
  if (is_distributed()) return read_losses_of_ranks();
  if (!unread_loss) return;
  const UnreadLoss read = *std::exchange(unread_loss, std::nullopt);
  add_loss(read, loss.value().loss);
}

void Trainer::Impl::add_loss(const UnreadLoss& of, double value) {
  if (!std::isfinite(value)) {
    throw LossError(detail::concat("iteration ", of.iteration, ", view ", of.view, ": the loss is ", value,
                                   recorder.last_checkpoint()));
  }
  state.loss_average = of.iteration == 1 ? value : 0.4 * value + 0.6 * state.loss_average;
}

void Trainer::Impl::update_filters(bool is_due) {
  if (!smoothing_filter || state.n_gaussians() == 0) return;
  if (!is_due && state.gaussians.filters.defined()) return;
  if (!is_distributed()) return smoothing_filter->compute(state.gaussians);
  smoothing_filter->compute(state.gaussians, [this](torch::Tensor& largest) {
    torch::Tensor bits = largest.view(torch::kInt32).to(torch::kInt64);  // in the order of the values
    ranks->all_reduce_max(bits);
    largest = bits.to(torch::kInt32).view(torch::kFloat32);
  });
}

void Trainer::Impl::prepare_appearance() {
  if (appearance == nullptr) {
    state.appearance = {};
  } else if (!appearance->fits(state.appearance)) {
    state.appearance = appearance->make_state();
  }
}

Trainer::Impl::ComparedView Trainer::Impl::compare(const TrainView& view, bool is_filter_due) {
  ComparedView compared;
  compared.plan = density->plan(state.iteration);
  compared.refines_pose = poses.refines(view.index, state.iteration);
  try {
    RenderSettings settings = step_settings();
    settings.camera_gradient = compared.refines_pose;
    // Only the forward pass is retried: the backward pass needs no memory beyond what the forward pass took.
    compared.rendered = with_remedies({wait_for_files(), free_scratch(), release_photographs()}, [&] {
      update_filters(is_filter_due);
      RenderedView image = stepper.forward(state.gaussians, state.adam, view.camera, settings);
      if (keeps_views()) {
        stepper.make_room_for_view(state.gaussians);
        if (compared.plan.statistics) make_room_for_statistics();
      }
      return image;
    });
  } catch (const InvalidGaussianError&) {
    throw;
  } catch (const NumericError& error) {
    throw NumericError(detail::concat("iteration ", state.iteration, ", view ", view.name, ": ", error.what()));
  }
  note_view_size();
  note_visibility(view.index, rasterizer.view_size().n_pairs == 0);
  read_loss();  // of the view before: the device has finished it by now
  if (!step_start.loss_average) step_start.loss_average = state.loss_average;
  compare_with_photograph(view, compared);
  unread_loss = {state.iteration, view.name, view.index};
  if (device.is_cpu()) read_loss();
  return compared;
}

void Trainer::Impl::note_view_size() {
  ViewSize view_size = rasterizer.view_size();
  // Memory is planned for views of full size: there a splat touches at most as many times more tiles.
  const std::int64_t scale = coarse_scale_at(config, state.iteration);
  view_size.n_pairs *= scale * scale;
  if (memory_is_limited) state.view_ratios.add(view_size.n_splats, view_size.n_pairs, state.gaussians.size());
  if (const std::int64_t bytes = rasterizer.memory_bytes(); bytes != std::exchange(view_bytes, bytes)) trim_memory();
}

void Trainer::Impl::note_visibility(std::int32_t view, bool is_empty) {
  empty_views.resize(static_cast<std::size_t>(images.size()));
  empty_views[static_cast<std::size_t>(view)] = is_empty;
  if (++n_views_drawn == empty_views.size()) warn_of_empty_views();
}

void Trainer::Impl::warn_of_empty_views() {
  const auto n = static_cast<std::size_t>(std::count(empty_views.begin(), empty_views.end(), true));
  if (n == 0 || (n <= n_warned_empty && 2 * n < empty_views.size())) return;
  n_warned_empty = n;
  if (is_distributed() && !ranks->is_first()) return;
  const auto first = std::find(empty_views.begin(), empty_views.end(), true) - empty_views.begin();
  recorder.warn(detail::concat("after iteration ", state.iteration, ": no Gaussian is visible in ", n, " of ",
                               images.size(),
                               " training views (first: ", scene.train[static_cast<std::size_t>(first)].name,
                               "); check their poses, --near_plane (", config.near_plane, ") and the learning rates"));
}

void Trainer::Impl::compare_with_photograph(const TrainView& view, ComparedView& compared) {
  const RenderedView& rendered = compared.rendered;
  timer.begin(Stage::kLoss);
  if (appearance) {
    appearance->begin_step(view.index, state.iteration, state.appearance);
    appearance->set_photograph(view.truth);
  }
  compared.color = appearance ? appearance->apply(state.appearance, view.index, rendered.color) : rendered.color;
  const LossWeights weights = loss_weights(config);
  loss.compute(compared.color, view.truth, view.valid, view.n_valid, weights);
  if (view.empty.defined() && weights.alpha > 0) loss.add_alpha(rendered.alpha, view.empty, weights.alpha);
  if (compared.plan.score) error_image.compute(compared.color, view.truth, view.valid);
  RenderedViewGrad& grad = compared.grad;
  grad = loss.grad();
  if (appearance) appearance->backward(state.appearance, view.index, rendered.color, grad.color);
  if (depth_priors) grad.depth = depth_gradient(view, rendered);
  timer.end();
}

void Trainer::Impl::add_to_statistics(const TrainView& view, const ComparedView& compared,
                                      const ViewStatistics& statistics) {
  DensityStep step{state.iteration, statistics, view.camera.width, view.camera.height};
  if (compared.plan.score) {
    step.add_scores = [this](const GaussianScores& scores) { rasterizer.score(error_image.error(), scores); };
  }
  density->after_view(step, state.statistics);
}

void Trainer::Impl::learn(const TrainView& view) {
  const ComparedView compared = compare(view, is_filter_iteration(state.iteration));
  const ViewStatistics statistics =
      stepper.step(adam_rates(config, scene.extent, state.iteration), compared.grad, state.gaussians, state.adam,
                   &timer, regularization_weights(config, scene.extent));
  if (compared.refines_pose) {
    poses.add_gradient(view.index, state.iteration, statistics.camera_grad);
    poses.begin_step();
  }
  if (device.is_cpu()) poses.finish_step();
  if (appearance) {
    timer.begin(Stage::kOptimizer);
    appearance->step(view.index, state.iteration, state.appearance);
    timer.end();
  }
  if (compared.plan.after_step) {
    timer.begin(Stage::kDensify);
    add_to_statistics(view, compared, statistics);
    density->after_step(state.iteration, state.gaussians);
    timer.end();
  }
}

torch::Tensor Trainer::Impl::depth_gradient(const TrainView& view, const RenderedView& rendered) {
  if (!depth_priors->has(view.index)) return {};
  const double weight =
      log_linear_rate(config.depth_l1_weight_init, config.depth_l1_weight_final, config.iterations, state.iteration);
  return depth_priors->gradient(view.index, rendered.depth, view.valid, view.n_valid,
                                images.stored_view(view.index).valid, weight);
}

BlendInput Trainer::Impl::kernel_check_input() {
  BlendInput input{rasterizer, flushed_state().gaussians, evaluation_settings(config, state.sh_degree), {}};
  if (is_distributed()) {
    input.render = [this, settings = input.settings](const PinholeView& view) { return render(view, settings); };
  }
  for (const std::int32_t view :
       state.view_order.upcoming(config.seed, images.size(), static_cast<std::size_t>(config.kernel_check_views))) {
    input.views.push_back(images.stored_view(view).camera);
  }
  return input;
}

CheckMoment Trainer::Impl::check_moment(int iteration) const {
  CheckMoment now{iteration, recorder.step_ms()};
  if (kernels.is_due(now)) now.is_after_reset = density->is_recovering(iteration);
  return now;
}

void Trainer::Impl::check_kernels(int iteration) {
  const CheckMoment now = check_moment(iteration);
  if (is_distributed() ? !agreed.check_kernels : !kernels.is_due(now)) return;
  on_first_rank([&] {
    recorder.report_progress("checking kernels");
    for (const KernelCheck& check : kernels.check(now, kernel_check_input())) {
      recorder.log_event(iteration, "kernel_check", to_json(check));
      if (!check.message.empty()) recorder.say(check.message);
    }
  });
  if (is_distributed()) adopt_kernels_of_first_rank();
  state.kernel_selection = kernels.to_json();
}

TrainView Trainer::Impl::take_view(int iteration) {
  const std::vector<std::int32_t> next =
      state.view_order.upcoming(config.seed, images.size(), 1 + images.n_upcoming_wanted());
  TrainView view = images.take(next.front(), {next.begin() + 1, next.end()});
  view.camera = poses.camera(view.index);
  const int scale = coarse_scale_of(coarse_scale_at(config, iteration), view.camera.width, view.camera.height);
  return reducer.reduce(view, scene.train[static_cast<std::size_t>(next.front())].valid.get(), scale);
}

void Trainer::Impl::take_step() {
  if (is_distributed()) return take_distributed_step();
  if (keeps_views()) return take_batched_step();
  // Consecutive steps are similar, so one in a hundred is timed. Not a multiple of 100: there density control changes
  // the number of Gaussians, and the next step reallocates.
  constexpr int kTimedInterval = 100, kTimedPhase = 50;
  const int iteration = state.iteration + 1;
  if (hooks.on_stage_times || iteration % kTimedInterval == kTimedPhase) timer.start(StageTimes::Kind::kStep);
  timer.begin(Stage::kUpload);
  const TrainView view = take_view(iteration);
  timer.end();
  // Not before: if the photograph cannot be read, the state must be that after the last step.
  state.iteration = iteration;
  state.step_iterations = 1;
  state.view_order.next(config.seed, images.size());
  if (iteration % config.sh_increase_interval == 0) state.sh_degree = std::min(state.sh_degree + 1, config.sh_degree);
  learn(view);
  timer.finish();
}

void Trainer::Impl::step() {
  check_kernels(state.iteration + 1);
  for (;;) {
    step_start.iteration = state.iteration;
    step_start.step_iterations = state.step_iterations;
    step_start.sh_degree = state.sh_degree;
    step_start.adam_steps = state.adam.steps;
    step_start.view_order = state.view_order;
    step_start.loss_average.reset();
    try {
      take_step();
      state.is_density_pending = true;
      return;
    } catch (const InvalidGaussianError& error) {
      roll_back();
      remove_invalid_gaussians(error);
    } catch (const LossError&) {
      throw;
    } catch (...) {
      roll_back();
      throw;
    }
  }
}

}  // namespace b3dgs
