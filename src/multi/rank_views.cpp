// Which views a step takes, who renders them, what is read ahead for that, and what ranks tell each other of them a
// step later: losses and counted work.

#include <torch/types.h>

#include <algorithm>
#include <numeric>
#include <utility>

#include "config/batch_steps.h"
#include "multi/rank_stepper.h"

namespace b3dgs {

namespace {

constexpr std::size_t kPlannedSteps = 4;  // whose views are assigned to ranks at a time

}  // namespace

std::vector<RankStepper::ViewOfStep> RankStepper::next_views_of_step(int last) {
  std::vector<ViewOfStep> views;
  const std::size_t n_most = n_views_at_a_time();
  while (state_.iteration < last && views.size() < n_most) {
    const int iteration = state_.iteration + 1;
    state_.iteration = iteration;
    views.push_back({state_.view_order.next(config_.seed, training_.views.size()), iteration});
  }
  return views;
}

std::size_t RankStepper::n_views_at_a_time() const {
  const double n_splats = model_ratios_.splats() * static_cast<double>(state_.n_gaussians());
  return views_at_a_time(n_splats, splats_at_a_time_, ranks_.size());
}

std::vector<std::int32_t> RankStepper::own_views_ahead() {
  // How many views are read ahead differs between ranks, but plans must not: a few steps are planned, others guessed.
  const std::size_t batch = static_cast<std::size_t>(config_.batch),
                    n_wanted = training_.views.images.n_upcoming_wanted();
  const std::size_t n_views =
      std::max((n_wanted + 1) * std::max(static_cast<std::size_t>(ranks_.size()), batch), kPlannedSteps * batch);
  const std::vector<std::int32_t> upcoming = training_.views.upcoming(state_.view_order, n_views);
  const std::size_t n_most = n_views_at_a_time();
  std::vector<std::int32_t> own;
  int iteration = state_.iteration;
  auto view = upcoming.begin();
  for (std::size_t n_steps = 0; view != upcoming.end() && iteration < config_.iterations; ++n_steps) {
    const int last = step_end(config_.batch, config_.iterations, iteration);
    while (view != upcoming.end() && iteration < last) {
      const int from = iteration;
      std::vector<ViewOfStep> step;  // or a part of it
      for (; view != upcoming.end() && iteration < last && step.size() < n_most; ++view) {
        ++iteration;
        step.push_back({*view, iteration});
      }
      const std::vector<int> renderers =
          n_steps + 1 < kPlannedSteps ? planned_renderers(from, step) : equal_renderers(step.size(), ranks_.size());
      for (std::size_t v = 0; v < step.size(); ++v) {
        if (renderers[v] == ranks_.rank()) own.push_back(step[v].index);
      }
    }
  }
  return own;
}

std::vector<int> RankStepper::planned_renderers(int from, const std::vector<ViewOfStep>& views) {
  std::vector<std::int32_t> indices;
  indices.reserve(views.size());
  for (const ViewOfStep& view : views) indices.push_back(view.index);
  return render_plan_.renderers(from, indices);
}

void RankStepper::read_own_loss() {
  if (!own_views_.empty() && !own_views_.back().loss) own_views_.back().loss = training_.objective.value();
}

torch::Tensor RankStepper::queue_row_entries() const {
  const torch::Tensor entries = training_.rasterizer.row_entries();
  if (training_.device.is_cpu()) return entries;
  torch::Tensor on_host = torch::empty(entries.sizes(), torch::dtype(torch::kInt64).pinned_memory(true));
  return on_host.copy_(entries, /*non_blocking=*/true);
}

RenderedRecord RankStepper::take_rendered() {
  read_own_loss();  // queued behind the entries, which are there, too
  RenderedRecord record;
  for (const OwnView& own : std::exchange(own_views_, {})) {
    const auto* const entries = own.entries.data_ptr<std::int64_t>();
    record.losses[own.index] = *own.loss;
    record.entries[own.index] = std::accumulate(entries, entries + own.entries.size(0), std::int64_t{0});
  }
  return record;
}

void RankStepper::read_losses() {
  training_.views.poses.finish_step();
  if (!unread_losses_.empty()) add_rendered(ranks_.exchange_record("rendered", take_rendered()));
}

void RankStepper::add_rendered(const std::vector<RenderedRecord>& of_ranks) {
  const std::vector<ViewOfStep> unread = std::exchange(unread_losses_, {});
  for (std::size_t v = 0; v < unread.size(); ++v) {
    const RenderedRecord& of_renderer = of_ranks[static_cast<std::size_t>(renderers_[v])];
    render_plan_.set_work(unread[v].index, of_renderer.entries[v]);
    add_loss(unread[v], of_renderer.losses[v]);
  }
}

}  // namespace b3dgs
