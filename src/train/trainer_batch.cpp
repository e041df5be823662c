// A step of several views (--batch). An iteration stays one view, so that schedules keep their meaning: a step takes
// the iterations up to the next multiple of --batch. Each view is rendered, compared and blended backward as in a step
// of its own, with what its iteration says; the gradients of its splats are kept. Then one pass over the Gaussians sums
// the views' gradients and takes the Adam step. What falls on one of the iterations and is not part of a step (density
// control, evaluation, files) comes after the step.
//
// What is learned of each photograph (appearance, pose) takes a step for each view, as with one view in a step. Of
// several ranks, the one that draws a view tells the others these gradients, and all learn the same.

#include <cmath>
#include <utility>

#include "config/batch_steps.h"
#include "raster/torch/tensor_storage.h"
#include "train/loss/loss_weights.h"
#include "train/optimizer/lr_schedule.h"
#include "train/ranks/rows/sharded_rows.h"
#include "train/trainer_impl.h"

namespace b3dgs {

void Trainer::Impl::make_room_for_statistics() {
  const std::vector<torch::Tensor*> columns = state.statistics.all();
  saved_statistics.columns.resize(columns.size());
  saved_statistics.rooms.resize(columns.size());
  for (std::size_t i = 0; i < columns.size(); ++i) {
    place_tensor(saved_statistics.columns[i], saved_statistics.rooms[i], columns[i]->sizes(), columns[i]->options(),
                 /*spare_part=*/4);
  }
}

void Trainer::Impl::save_statistics() {
  if (std::exchange(saved_statistics.is_in_use, true)) return;
  for (std::size_t i = 0; i < saved_statistics.columns.size(); ++i) {
    saved_statistics.columns[i].copy_(*state.statistics.all()[i]);
  }
}

void Trainer::Impl::keep_view(const TrainView& view, bool is_filter_due) {
  const int place = stepper.n_kept_views();
  if (appearance) appearance->set_place(place);
  const ComparedView compared = compare(view, is_filter_due);
  const ViewStatistics statistics =
      stepper.keep_view(compared.grad, state.gaussians, regularization_weights(config, scene.extent));
  if (compared.refines_pose) poses.add_gradient(view.index, state.iteration, statistics.camera_grad);
  if (compared.plan.statistics) {
    timer.begin(Stage::kDensify);
    save_statistics();
    add_to_statistics(view, compared, statistics);
    timer.end();
  }
  learned_views.push_back({view.index, state.iteration});
}

void Trainer::Impl::learn_from_kept_views() {
  const int n_views = stepper.n_kept_views();
  stepper.step_views(adam_rates(config, scene.extent, state.iteration), state.gaussians, state.adam, &timer);
  saved_statistics.is_in_use = false;
  poses.begin_step();
  if (device.is_cpu()) poses.finish_step();
  if (appearance) {
    timer.begin(Stage::kOptimizer);
    for (int place = 0; place < n_views; ++place) {
      const LearnedView& view = learned_views[static_cast<std::size_t>(place)];
      appearance->set_place(place);
      appearance->begin_step(view.index, view.iteration, state.appearance);
      appearance->step(view.index, view.iteration, state.appearance);
    }
    timer.end();
  }
  timer.begin(Stage::kDensify);
  for (const LearnedView& view : learned_views) density->after_step(view.iteration, state.gaussians, owners.own());
  timer.end();
}

bool Trainer::Impl::begin_step_of_views(int last) {
  const int from = state.iteration;
  const auto has_multiple = [&](int interval, int phase) {  // a k in the step with k % interval == phase
    return (last - phase + interval) / interval > (from - phase + interval) / interval;
  };
  constexpr int kTimedInterval = 100, kTimedPhase = 50;
  if (hooks.on_stage_times || has_multiple(kTimedInterval, kTimedPhase)) timer.start(StageTimes::Kind::kStep);
  state.step_iterations = last - from;
  state.sh_degree = std::min(state.sh_degree + last / config.sh_increase_interval - from / config.sh_increase_interval,
                             config.sh_degree);
  bool is_filter_due = false;
  for (int iteration = from + 1; iteration <= last; ++iteration) is_filter_due |= is_filter_iteration(iteration);
  learned_views.clear();
  return is_filter_due;
}

void Trainer::Impl::take_batched_step() {
  const int last = step_end(config.batch, config.iterations, state.iteration);
  bool is_filter_due = begin_step_of_views(last);
  for (int iteration = state.iteration + 1; iteration <= last; ++iteration) {
    timer.begin(Stage::kUpload);
    const TrainView view = take_view(iteration);
    timer.end();
    state.iteration = iteration;
    state.view_order.next(config.seed, images.size());
    keep_view(view, std::exchange(is_filter_due, false));
  }
  learn_from_kept_views();
  timer.finish(state.step_iterations);
}

std::int64_t Trainer::Impl::n_shared_columns() const {
  std::int64_t n = config.pose_opt ? kCameraColumns : 0;
  if (appearance) n += appearance->grad().numel();
  return n + n % 2;  // rows of doubles
}

torch::Tensor Trainer::Impl::shared_gradients() const {
  torch::Tensor row = torch::zeros({n_shared_columns()}, torch::dtype(torch::kFloat32).device(device));
  std::int64_t begin = config.pose_opt ? kCameraColumns : 0;
  const auto append = [&](const torch::Tensor& values) {
    row.slice(0, begin, begin + values.numel()).copy_(values.flatten());
    begin += values.numel();
  };
  if (appearance) append(appearance->grad());
  return row;
}

void Trainer::Impl::keep_shared_gradients(const std::vector<LearnedView>& learned,
                                          const std::vector<torch::Tensor>& drawn) {
  const auto options = torch::dtype(torch::kFloat32).device(device);
  const torch::Tensor own = drawn.empty() ? torch::empty({0, n_shared_columns()}, options) : torch::stack(drawn);
  const torch::Tensor rows = gather_view_rows(*ranks, own, step_drawers);
  for (std::size_t v = 0; v < learned.size(); ++v) {
    const torch::Tensor row = rows.select(0, static_cast<std::int64_t>(v));
    const std::size_t place = learned_views.size() + v;
    std::int64_t begin = config.pose_opt ? kCameraColumns : 0;
    const auto next_like = [&](const torch::Tensor& values) {
      begin += values.numel();
      return row.slice(0, begin - values.numel(), begin).view(values.sizes());
    };
    if (poses.refines(learned[v].index, learned[v].iteration)) {
      poses.add_gradient(learned[v].index, learned[v].iteration, row.slice(0, 0, kCameraColumns).view(torch::kFloat64));
    }
    if (appearance) {
      appearance->set_place(static_cast<int>(place));
      appearance->grad().copy_(next_like(appearance->grad()));
    }
  }
}

}  // namespace b3dgs
