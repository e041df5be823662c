// Which views a step of several ranks takes, who draws them, and what is read ahead for that.

#include <algorithm>

#include "config/batch_steps.h"
#include "config/coarse_schedule.h"
#include "train/loss/loss_weights.h"
#include "train/trainer_impl.h"

namespace b3dgs {

namespace {

constexpr std::size_t kPlannedSteps = 4;  // whose views are assigned to ranks at a time

}  // namespace

PinholeView Trainer::Impl::camera_of(std::int32_t index, int iteration) {
  const PinholeView camera = poses.camera(index);
  const int scale = coarse_scale_of(coarse_scale_at(config, iteration), camera.width, camera.height);
  return scale == 1 ? camera : reduced_camera(camera, scale);
}

TrainView Trainer::Impl::take_own_view(int iteration, std::int32_t index, const std::vector<std::int32_t>& next) {
  TrainView view = images.take(index, next);
  view.camera = poses.camera(index);
  const int scale = coarse_scale_of(coarse_scale_at(config, iteration), view.camera.width, view.camera.height);
  return reducer.reduce(view, scene.train[static_cast<std::size_t>(index)].valid.get(), scale);
}

std::vector<Trainer::Impl::LearnedView> Trainer::Impl::next_views_of_step(int last) {
  std::vector<LearnedView> views;
  const std::size_t n_most = n_views_at_a_time(state.iteration + 1);
  while (state.iteration < last && views.size() < n_most) {
    const int iteration = state.iteration + 1;
    const std::int32_t index = state.view_order.upcoming(config.seed, images.size(), 1).front();
    state.iteration = iteration;
    state.view_order.next(config.seed, images.size());
    views.push_back({index, iteration});
  }
  return views;
}

bool Trainer::Impl::may_cut_views() const {
  return n_shared_columns() == 0 && loss_weights(config).alpha == 0;
}

std::size_t Trainer::Impl::n_views_at_a_time(int iteration) const {
  const double n_splats = model_ratios.splats() * static_cast<double>(state.n_gaussians());
  return views_at_a_time(n_splats, config.rank_splats, ranks->size(), may_cut_views());
}

std::vector<std::int32_t> Trainer::Impl::own_views_ahead() {
  // How many views are read ahead differs between ranks, but plans must not: a few steps are planned, others guessed.
  const std::size_t batch = static_cast<std::size_t>(config.batch), n_wanted = images.n_upcoming_wanted();
  const std::size_t n_views =
      std::max((n_wanted + 1) * std::max(static_cast<std::size_t>(ranks->size()), batch), kPlannedSteps * batch);
  const std::vector<std::int32_t> upcoming = state.view_order.upcoming(config.seed, images.size(), n_views);
  std::vector<std::int32_t> own;
  int iteration = state.iteration;
  auto view = upcoming.begin();
  for (std::size_t n_steps = 0; view != upcoming.end() && iteration < config.iterations; ++n_steps) {
    const int last = step_end(config.batch, config.iterations, iteration);
    while (view != upcoming.end() && iteration < last) {
      const int from = iteration;
      const std::size_t n_most = n_views_at_a_time(from + 1);
      std::vector<LearnedView> step;  // or a part of it
      for (; view != upcoming.end() && iteration < last && step.size() < n_most; ++view) {
        ++iteration;
        step.push_back({*view, iteration});
      }
      const StepPlan plan = n_steps + 1 < kPlannedSteps ? planned_step(from, step)
                                                        : whole_views(equal_drawers(step.size(), ranks->size()));
      for (const DrawnPart& part : plan) {
        if (part.rank == ranks->rank()) own.push_back(step[part.view].index);
      }
    }
  }
  return own;
}

StepPlan Trainer::Impl::planned_step(int from, const std::vector<LearnedView>& views) {
  if (views.empty()) return {};
  const std::int32_t height_of_tile = step_settings().tile.height;
  std::vector<DrawPlan::PlannedView> planned;
  for (const LearnedView& view : views) {
    const std::int32_t height = camera_of(view.index, view.iteration).height;
    planned.push_back({view.index, (height + height_of_tile - 1) / height_of_tile});
  }
  return draw_plan.plan(from, planned, may_cut_views());
}

}  // namespace b3dgs
