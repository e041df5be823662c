// Which views a step of several ranks takes, who draws them, and what is read ahead for that.

#include <algorithm>

#include "config/batch_steps.h"
#include "config/coarse_schedule.h"
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
  const std::size_t n_most = n_views_at_a_time();
  while (state.iteration < last && views.size() < n_most) {
    const int iteration = state.iteration + 1;
    const std::int32_t index = state.view_order.upcoming(config.seed, images.size(), 1).front();
    state.iteration = iteration;
    state.view_order.next(config.seed, images.size());
    views.push_back({index, iteration});
  }
  return views;
}

std::size_t Trainer::Impl::n_views_at_a_time() const {
  const double n_splats = model_ratios.splats() * static_cast<double>(state.n_gaussians());
  return views_at_a_time(n_splats, hooks.rank_splats, ranks->size());
}

std::vector<std::int32_t> Trainer::Impl::own_views_ahead() {
  // How many views are read ahead differs between ranks, but plans must not: a few steps are planned, others guessed.
  const std::size_t batch = static_cast<std::size_t>(config.batch), n_wanted = images.n_upcoming_wanted();
  const std::size_t n_views =
      std::max((n_wanted + 1) * std::max(static_cast<std::size_t>(ranks->size()), batch), kPlannedSteps * batch);
  const std::vector<std::int32_t> upcoming = state.view_order.upcoming(config.seed, images.size(), n_views);
  const std::size_t n_most = n_views_at_a_time();
  std::vector<std::int32_t> own;
  int iteration = state.iteration;
  auto view = upcoming.begin();
  for (std::size_t n_steps = 0; view != upcoming.end() && iteration < config.iterations; ++n_steps) {
    const int last = step_end(config.batch, config.iterations, iteration);
    while (view != upcoming.end() && iteration < last) {
      const int from = iteration;
      std::vector<LearnedView> step;  // or a part of it
      for (; view != upcoming.end() && iteration < last && step.size() < n_most; ++view) {
        ++iteration;
        step.push_back({*view, iteration});
      }
      const std::vector<int> drawers =
          n_steps + 1 < kPlannedSteps ? planned_drawers(from, step) : equal_drawers(step.size(), ranks->size());
      for (std::size_t v = 0; v < step.size(); ++v) {
        if (drawers[v] == ranks->rank()) own.push_back(step[v].index);
      }
    }
  }
  return own;
}

std::vector<int> Trainer::Impl::planned_drawers(int from, const std::vector<LearnedView>& views) {
  if (views.empty()) return {};
  std::vector<std::int32_t> indices;
  for (const LearnedView& view : views) indices.push_back(view.index);
  return draw_plan.drawers(from, indices);
}

}  // namespace b3dgs
