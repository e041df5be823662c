// One step: view, SH degree, forward pass, loss, backward pass with Adam, density statistics.
//
// The original 3DGS differs in two places. It runs density control before Adam; that replaces the parameters, so the
// gradients of such a step are lost. Here they are used. And it skips Adam in the very last iteration; here all
// iterations are alike, so that a training resumed with more iterations equals one that never stopped. Each affects
// at most one step in a hundred. As in the original, an iteration's evaluation and PLY show the model before that
// iteration's density control; otherwise an opacity reset would show in the figures.
#include "train/stepper.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "config/batch_steps.h"
#include "config/coarse_schedule.h"
#include "core/random.h"
#include "core/text.h"
#include "raster/torch/tensors.h"
#include "train/checkpoint/checkpoint.h"
#include "train/evaluate.h"
#include "train/optimizer/adam.h"

namespace b3dgs {

Stepper::Stepper(Training& training)
    : training_(training),
      state_(training.state),
      config_(training.config),
      optimizer_(training.rasterizer),
      row_editor_([this](auto sizes, const auto& options) { return training_.memory->allocate(sizes, options); }) {
  std::vector<CameraView> views;
  for (const View& view : training.scene.train) views.push_back(to_camera_view(view.camera));
  largest_view_ = *std::max_element(views.begin(), views.end(), [](const CameraView& a, const CameraView& b) {
    return std::int64_t{a.width} * a.height < std::int64_t{b.width} * b.height;
  });
  for (const CameraView& view : views) {  // memory is forecast for its size with the most splats
    if (splats_per_gaussian(view.lens) > splats_per_gaussian(largest_view_.lens)) largest_view_.lens = view.lens;
  }
  if (!config_.antialiasing) return;
  smoothing_filter_.emplace(views, static_cast<float>(config_.near_plane), training.device);
}

// --- Steps ---

void Stepper::step() {
  // A rank that repeated a step alone would leave the others waiting: it repeats what it does alone.
  std::vector<MemoryRemedy> remedies;
  if (is_alone()) remedies = training_.remedies();
  for (bool is_taken = false; !is_taken;) {
    before_ = {static_cast<const StepPosition&>(state_), state_.adam.steps};
    try {
      take_step();
      is_taken = true;
    } catch (const LossError&) {
      throw;
    } catch (const InvalidGaussianError& error) {
      roll_back();
      remove_invalid_gaussians(error);
    } catch (...) {
      roll_back();
      if (!training_.is_consistent) throw;  // the Gaussians have changed
      free_memory_or_rethrow(remedies);
    }
  }
  state_.n_density_pending = state_.step_iterations;
}

void Stepper::take_step() {
  const int from = state_.iteration, last = step_end(config_.batch, config_.iterations, from);
  begin_step(last);
  for (int iteration = from + 1; iteration <= last; ++iteration) {
    training_.timer.begin(Stage::kUpload);
    state_.iteration = iteration;
    const std::int32_t index = state_.view_order.next(config_.seed, training_.views.size());
    const TrainView view = training_.views.take(
        index, iteration, training_.views.upcoming(state_.view_order, training_.views.images.n_upcoming_wanted()));
    training_.timer.end();
    learn_view(view);
  }
  finish_step();
}

void Stepper::begin_step(int last) {
  const int from = state_.iteration;
  const auto has_multiple = [&](int interval, int phase) {  // a k in the step with k % interval == phase
    return (last - phase + interval) / interval > (from - phase + interval) / interval;
  };
  // Consecutive steps are similar, so one in a hundred is timed. Not a multiple of 100: there density control changes
  // the number of Gaussians, and the next step reallocates. Filters follow the means, which move slowly.
  constexpr int kInterval = 100, kTimedPhase = 50, kFilterPhase = 1;
  if (training_.hooks.on_stage_times || has_multiple(kInterval, kTimedPhase)) {
    training_.timer.start(StageTimes::Kind::kStep);
  }
  state_.step_iterations = last - from;
  state_.sh_degree = std::min(
      state_.sh_degree + last / config_.sh_increase_interval - from / config_.sh_increase_interval, config_.sh_degree);
  learned_views_.clear();
  update_filters(has_multiple(kInterval, kFilterPhase));
}

void Stepper::learn_view(const TrainView& view) {
  const int iteration = state_.iteration;
  const DensityPlan plan = training_.density->plan(iteration);
  decide_kernel(iteration);
  RenderSettings settings = step_settings(iteration);
  settings.camera_gradient = training_.views.poses.refines(view.index, iteration);
  RenderedView rendered;
  try {
    // On a GPU, forward() then also applies deferred updates (DeferredSh is the ColorPass).
    settings = optimizer_.begin_view(state_.gaussians, state_.adam, training_.kernels.begin_view(iteration, settings));
    rendered = training_.rasterizer.forward(state_.gaussians, view.camera, settings);
  } catch (const InvalidGaussianError&) {
    throw;
  } catch (const NumericError& error) {
    throw NumericError(detail::concat("iteration ", iteration, ", view ", view.name, ": ", error.what()));
  }
  if (keeps_gradients()) {
    optimizer_.make_room_for_view(state_.gaussians);
    if (plan.statistics) save_statistics();
  }
  note_view_size(iteration);
  note_visibility(view.index, training_.rasterizer.view_size().n_pairs == 0);
  complete_pending();  // of the view before: the device has finished it by now

  if (training_.objective.appearance()) {
    training_.objective.appearance()->set_place(static_cast<int>(learned_views_.size()));
  }
  const RenderedViewGrad grad = compare(view, iteration, rendered, plan.score);
  learned_views_.push_back({view.index, iteration});
  unread_losses_ = {learned_views_.back()};
  if (training_.device.is_cpu()) complete_pending();

  const ViewStatistics statistics =
      keeps_gradients()
          ? optimizer_.backward_and_keep(view.camera, settings, grad, state_.gaussians, regularization())
          : optimizer_.backward_and_step(adam_rates(config_, training_.scene.extent, iteration), grad, state_.gaussians,
                                         state_.adam, &training_.timer, regularization());
  if (settings.camera_gradient) training_.views.poses.add_gradient(view.index, iteration, statistics.camera_grad);
  if (!plan.statistics) return;
  training_.timer.begin(Stage::kDensify);
  DensityView seen{iteration, statistics, view.camera.width, view.camera.height};
  if (plan.score) {
    seen.add_scores = [&](const GaussianScores& scores) {
      training_.rasterizer.score(training_.objective.errors(), scores);
    };
  }
  training_.density->after_view(seen, state_.statistics);
  training_.timer.end();
}

void Stepper::finish_step(const torch::Tensor& model_rows) {
  if (optimizer_.n_kept_views() > 0) {  // else backward_and_step() has stepped
    optimizer_.step_views(adam_rates(config_, training_.scene.extent, state_.iteration), state_.gaussians, state_.adam,
                          &training_.timer);
  }
  saved_statistics_.clear();
  training_.views.poses.queue_step();
  if (training_.device.is_cpu()) training_.views.poses.take_queued_steps();
  // What is learned of each photograph takes a step for each view.
  if (AppearanceModel* const appearance = training_.objective.appearance()) {
    training_.timer.begin(Stage::kOptimizer);
    for (std::size_t place = 0; place < learned_views_.size(); ++place) {
      const ViewOfStep& view = learned_views_[place];
      appearance->set_place(static_cast<int>(place));
      if (place > 0) appearance->begin_step(view.index, view.iteration, state_.appearance);
      appearance->step(view.index, view.iteration, state_.appearance);
    }
    training_.timer.end();
  }
  for (const ViewOfStep& view : learned_views_) {
    if (!training_.density->plan(view.iteration).after_step) continue;
    training_.timer.begin(Stage::kDensify);
    training_.density->after_step(view.iteration, state_.gaussians, model_rows);
    training_.timer.end();
  }
  training_.timer.finish(state_.step_iterations);
}

RegularizationWeights Stepper::regularization() const {
  const StepPosition& before = before_.position;
  return regularization_weights(config_, training_.scene.extent,
                                before.iteration > 0 ? before.loss_average : kRegularizedLoss);
}

RenderSettings Stepper::step_settings(int iteration) {
  RenderSettings settings = evaluation_settings(config_, state_.sh_degree);
  settings.kernel = kernel_named(training_.kernels.kernel());
  settings.stages = &training_.timer;
  settings.inverse_depth = settings.depth_gradient = training_.objective.has_depths();
  if (config_.random_background) {
    const auto color =
        random_uniform({config_.seed, RandomStream::kBackground, static_cast<std::uint32_t>(iteration)}, 0);
    settings.background = {color[0], color[1], color[2]};
  }
  return settings;
}

RenderedViewGrad Stepper::compare(const TrainView& view, int iteration, const RenderedView& rendered,
                                  bool wants_errors) {
  training_.timer.begin(Stage::kLoss);
  const RenderedViewGrad grad = training_.objective.compare(
      view, iteration, training_.views.images.stored_view(view.index).valid, rendered, wants_errors, state_.appearance);
  training_.timer.end();
  return grad;
}

void Stepper::decide_kernel(int next_iteration) {
  const bool is_over = next_iteration > config_.iterations;
  const std::optional<KernelDecision> check =
      is_over ? training_.kernels.finish(next_iteration) : training_.kernels.decide(next_iteration);
  if (!check) return;
  state_.kernel_selection = training_.kernels.to_json();
  if (!writes_files()) return;
  training_.recorder.log_event(next_iteration, "kernel_check", to_json(*check));
  if (!check->message.empty()) training_.recorder.say(check->message);
}

void Stepper::complete_pending() {
  training_.views.poses.take_queued_steps();
  for (const ViewOfStep& view : std::exchange(unread_losses_, {})) add_loss(view, training_.objective.value());
}

void Stepper::add_loss(const ViewOfStep& view, double value) {
  if (!std::isfinite(value)) {
    throw LossError(detail::concat("iteration ", view.iteration, ", view ",
                                   training_.scene.train[static_cast<std::size_t>(view.index)].name, ": the loss is ",
                                   value, last_checkpoint()));
  }
  state_.loss_average = view.iteration == 1 ? value : 0.4 * value + 0.6 * state_.loss_average;
  if (view.iteration <= before_.position.iteration) before_.position.loss_average = state_.loss_average;
}

void Stepper::update_filters(bool is_due) {
  if (!smoothing_filter_ || state_.n_gaussians() == 0) return;
  if (is_due || !state_.gaussians.filters.defined()) compute_filters(*smoothing_filter_);
}

void Stepper::prepare_appearance() {
  const AppearanceModel* const appearance = training_.objective.appearance();
  if (appearance == nullptr) {
    state_.appearance = {};
  } else if (!appearance->fits(state_.appearance)) {
    state_.appearance = appearance->make_state();
  }
}

void Stepper::write_checkpoint(const nlohmann::ordered_json& scene_fingerprint) {
  const TrainState& whole = flushed_state();
  training_.recorder.write_checkpoint(checkpoint_header(config_, whole, scene_fingerprint), checkpoint_tensors(whole));
}

// --- What is known of the views ---

void Stepper::note_view_size(int iteration) {
  ViewSize view_size = training_.rasterizer.view_size();
  // Memory is planned for views of full size: there a splat touches at most as many times more tiles.
  const std::int64_t scale = coarse_scale_at(config_, iteration);
  view_size.n_pairs *= scale * scale;
  if (training_.memory->limit()) {
    state_.view_ratios.add(view_size.n_splats, view_size.n_pairs, state_.gaussians.size());
  }
  const std::int64_t bytes = training_.rasterizer.memory_bytes();
  if (bytes != std::exchange(view_bytes_, bytes)) training_.trim_memory();
}

void Stepper::note_visibility(std::int32_t view, bool is_empty) {
  empty_views_.resize(training_.scene.train.size());
  empty_views_[static_cast<std::size_t>(view)] = is_empty;
  if (++n_rendered_ == empty_views_.size()) warn_of_empty_views();
}

void Stepper::warn_of_empty_views() {
  const auto n = static_cast<std::size_t>(std::count(empty_views_.begin(), empty_views_.end(), true));
  if (n == 0 || (n <= n_empty_at_warning_ && 2 * n < empty_views_.size())) return;
  n_empty_at_warning_ = n;
  if (!writes_files()) return;
  const auto first = std::find(empty_views_.begin(), empty_views_.end(), true) - empty_views_.begin();
  training_.recorder.warn(detail::concat(
      "after iteration ", state_.iteration, ": no Gaussian is visible in ", n, " of ", empty_views_.size(),
      " training views (first: ", training_.scene.train[static_cast<std::size_t>(first)].name,
      "); check their poses, --near_plane (", config_.near_plane, ") and the learning rates"));
}

// --- Failures ---

void Stepper::save_statistics() {
  if (!saved_statistics_.empty()) return;
  std::vector<torch::Tensor> saved;
  for (const torch::Tensor* column : state_.statistics.all()) saved.push_back(column->clone());
  saved_statistics_ = std::move(saved);
}

void Stepper::roll_back() {
  training_.timer.cancel();
  if (state_.adam.steps != before_.adam_steps) {  // begin_adam_step() was called: Gaussians may have changed
    training_.is_consistent = false;
    return;
  }
  const auto is_of_step = [&](const ViewOfStep& view) { return view.iteration > before_.position.iteration; };
  unread_losses_.erase(std::remove_if(unread_losses_.begin(), unread_losses_.end(), is_of_step), unread_losses_.end());
  optimizer_.drop_views();
  training_.views.poses.drop_gradients();
  for (std::size_t i = 0; i < saved_statistics_.size(); ++i) state_.statistics.all()[i]->copy_(saved_statistics_[i]);
  saved_statistics_.clear();
  static_cast<StepPosition&>(state_) = before_.position;
}

void Stepper::remove_invalid_gaussians(const InvalidGaussianError& error) {
  complete_pending();  // throws if one is not finite, which would be the cause
  flush();
  training_.is_consistent = false;
  const std::int64_t n = remove_invalid_rows(error.row());
  training_.is_consistent = true;
  state_.n_removed += n;
  const std::string reason = first_line(error.what());
  training_.recorder.log_event(state_.iteration, "gaussians_removed",
                               {{"count", n}, {"total", state_.n_removed}, {"reason", reason}});
  if (state_.n_gaussians() == 0) {
    throw LossError(detail::concat("after iteration ", state_.iteration,
                                   ": no Gaussian is left that can be rendered: ", reason, last_checkpoint()));
  }
  if (state_.n_removed < 2 * n_removed_at_warning_) return;
  n_removed_at_warning_ = state_.n_removed;
  training_.recorder.warn(detail::concat("after iteration ", state_.iteration, ": removed ", n,
                                         n == 1 ? " Gaussian" : " Gaussians", " that cannot be rendered (",
                                         state_.n_removed, " so far): ", reason));
}

std::int64_t Stepper::remove_invalid_rows(std::int64_t row) {
  return b3dgs::remove_invalid_gaussians(row, training_.scene.extent, state_.gaussians, state_.adam, state_.statistics);
}

// --- Density control ---

ViewMemory Stepper::memory_of_view() {
  return view_memory(step_settings(state_.iteration), largest_view_);
}

GaussianMemory Stepper::memory_of_gaussian() {
  return gaussian_memory(state_, memory_of_view(), state_.view_ratios, keeps_gradients() ? config_.batch : 0);
}

std::int64_t Stepper::memory_of_images() {
  const double taken = n_rendered_ == 0 ? 0 : 1.0 / coarse_scale_at(config_, state_.iteration);
  const double to_come = (1 - taken * taken) * static_cast<double>(training_.objective.bytes_per_pixel());
  const double n_pixels = static_cast<double>(largest_view_.width) * largest_view_.height;
  return static_cast<std::int64_t>(memory_of_view().of_image + to_come * n_pixels);
}

std::optional<std::int64_t> Stepper::room_for_gaussians() {
  const std::optional<std::int64_t> limit = training_.memory->limit();
  if (!limit) return std::nullopt;
  const std::int64_t counted = state_bytes(state_) + training_.rasterizer.memory_bytes() + optimizer_.kept_bytes();
  const std::int64_t others = std::max<std::int64_t>(0, training_.memory->use().in_use - counted);
  return largest_count(*limit, others + memory_of_images(), memory_of_gaussian());
}

void Stepper::reserve_rows(const RowEdit& edit, std::int64_t limit) {
  const std::int64_t n_rows = edit.sources.size(0);
  constexpr std::int64_t kSparePart = 8;
  std::int64_t n_room = n_rows + n_rows / kSparePart;
  if (limit > 0) n_room = std::max(n_rows, std::min(n_room, limit));
  try {
    row_editor_.reserve(edit, n_room, state_.gaussians, state_.adam, state_.statistics);
  } catch (const OutOfMemoryError&) {
    if (n_room == n_rows) throw;
    row_editor_.reserve(edit, n_rows, state_.gaussians, state_.adam, state_.statistics);
  }
}

void Stepper::apply_reserved(const RowEdit& edit, int iteration) {
  training_.is_consistent = false;
  row_editor_.apply(edit, state_.gaussians, state_.adam, state_.statistics);
  training_.density->end_round(iteration, state_.statistics);
  training_.is_consistent = true;
}

}  // namespace b3dgs
