// Which views a step takes, who renders them, what is read ahead for that, and what ranks tell each other of them a
// step later: losses and counted work.

#include <torch/types.h>

#include <algorithm>
#include <numeric>
#include <utility>

#include "config/batch_steps.h"
#include "multi/rank_stepper.h"

namespace b3dgs {

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
  const std::size_t n_wanted = training_.views.images.n_upcoming_wanted(), n_most = n_views_at_a_time();
  const auto n_of_step = static_cast<std::size_t>(std::max(ranks_.size(), config_.batch));
  const std::vector<std::int32_t> upcoming = training_.views.upcoming(state_.view_order, (n_wanted + 1) * n_of_step);
  std::vector<std::int32_t> own;
  int iteration = state_.iteration;
  for (auto view = upcoming.begin(); view != upcoming.end() && iteration < config_.iterations;) {
    const int last = step_end(config_.batch, config_.iterations, iteration);
    const std::ptrdiff_t n = std::min(
        {static_cast<std::ptrdiff_t>(n_most), static_cast<std::ptrdiff_t>(last - iteration), upcoming.end() - view});
    const std::vector<std::int32_t> part(view, view + n);  // of a step
    const std::vector<int> renderers = render_plan_.renderers(part);
    for (std::size_t v = 0; v < part.size(); ++v) {
      if (renderers[v] == ranks_.rank()) own.push_back(part[v]);
    }
    view += n;
    iteration += static_cast<int>(n);
  }
  return own;
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

void RankStepper::complete_pending() {
  training_.views.poses.take_queued_steps();
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
