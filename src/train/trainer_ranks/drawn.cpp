// What ranks tell each other of the views that they have drawn in the last step: losses, counted work, and times.

#include <torch/types.h>

#include <algorithm>
#include <numeric>

#include "train/trainer_impl.h"

namespace b3dgs {

namespace {

// Phases are timed in the first kMeasured iterations of a session after kWarmUp, and then in some steps.
constexpr int kWarmUp = 20, kMeasured = 40, kTimedInterval = 10;

}  // namespace

bool Trainer::Impl::times_phases(int from, int last) const {
  const int n_done = from - result.first_iteration;  // in this session
  return n_done >= kWarmUp && (n_done < kWarmUp + kMeasured || from / kTimedInterval != last / kTimedInterval);
}

void Trainer::Impl::advise_on_ranks() {
  if (!is_distributed()) return;
  const int n_steps = kMeasured / std::max(1, config.batch);
  const auto advice = rank_load.advise(std::max(1, n_steps * 3 / 4), device.is_cuda() ? "GPU" : "process");
  if (advice && writes_files()) recorder.say(*advice);
}

void Trainer::Impl::read_own_loss() {
  if (!own_parts.empty() && !own_parts.back().loss) own_parts.back().loss = loss.value().loss;
}

void Trainer::Impl::add_phase_times() {
  for (const auto& step : step_phases.take()) {
    ++own_totals.n_timed;
    own_totals.step_ms += step.wall_ms;
    for (std::size_t i = 0; i < step.ms.size(); ++i) {
      own_totals.phase_ms[i] += step.ms[i];
      if (is_exchange(static_cast<StepPhase>(i))) own_totals.exchange_ms += step.ms[i];
    }
  }
  for (const auto& round : round_phases.take()) {
    ++own_totals.n_rounds;
    own_totals.round_ms += round.wall_ms;
    for (std::size_t i = 0; i < round.ms.size(); ++i) own_totals.round_phase_ms[i] += round.ms[i];
  }
}

torch::Tensor Trainer::Impl::queue_row_entries() const {
  const torch::Tensor entries = rasterizer.row_entries();
  if (device.is_cpu()) return entries;
  torch::Tensor on_host = torch::empty(entries.sizes(), torch::dtype(torch::kInt64).pinned_memory(true));
  return on_host.copy_(entries, /*non_blocking=*/true);
}

DrawnParts Trainer::Impl::take_drawn() {
  read_own_loss();  // queued behind the entries, which are there, too
  DrawnParts drawn;
  DrawnRecord& record = drawn.record;
  for (const OwnPart& own : std::exchange(own_parts, {})) {
    record.losses[own.part.view] = *own.loss;
    const auto* const entries = own.entries.data_ptr<std::int64_t>();
    const std::int64_t height = own.entries.size(0);
    if (!own.part.is_band() && !is_banded(step_plan)) {
      record.entries[own.part.view] = std::accumulate(entries, entries + height, std::int64_t{0});
      continue;
    }
    for (std::int64_t row = own.part.rows.begin; row < own.part.rows.end && row * tile_height < height; ++row) {
      const std::int64_t top = row * tile_height, bottom = std::min(top + tile_height, height);
      drawn.rows.push_back(std::accumulate(entries + top, entries + bottom, std::int64_t{0}));
    }
  }
  add_phase_times();
  own_totals.sent_bytes = splats->sent_bytes();
  own_totals.received_bytes = splats->received_bytes();
  record.totals = own_totals;
  return drawn;
}

void Trainer::Impl::read_losses_of_ranks() {
  if (unread_losses.empty()) return;
  const DrawnParts own = take_drawn();
  std::vector<DrawnParts> of_ranks;
  for (auto& [record, rows] : exchange_with_numbers(*ranks, "drawn", own.record, own.rows)) {
    of_ranks.push_back({record, std::move(rows)});
  }
  add_drawn(of_ranks);
}

void Trainer::Impl::count_drawn(const std::vector<UnreadLoss>& views, const std::vector<DrawnParts>& of_ranks) {
  const int size = ranks->size();
  std::vector<std::int64_t> work(static_cast<std::size_t>(size)), equal_work(work);
  if (is_banded(step_plan)) {
    std::vector<std::vector<std::int64_t>> rows(views.size()), even(views.size());
    for (const DrawnPart& part : step_plan) {
      const std::vector<std::int64_t>& band = of_ranks[static_cast<std::size_t>(part.rank)].rows;
      for (const std::int64_t entries : band) work[static_cast<std::size_t>(part.rank)] += entries;
      rows[part.view].insert(rows[part.view].end(), band.begin(), band.end());
    }
    for (std::size_t v = 0; v < views.size(); ++v) even[v].assign(rows[v].size(), 1);
    for (const DrawnPart& part : counted_bands(even, size)) {
      const std::vector<std::int64_t>& of_view = rows[part.view];
      for (std::size_t row = static_cast<std::size_t>(part.rows.begin);
           row < of_view.size() && row < static_cast<std::size_t>(part.rows.end); ++row) {
        equal_work[static_cast<std::size_t>(part.rank)] += of_view[row];
      }
    }
    for (std::size_t v = 0; v < views.size(); ++v) draw_plan.set_row_work(views[v].view_index, std::move(rows[v]));
  } else {
    const std::vector<int> in_turn = equal_drawers(views.size(), size);
    for (const DrawnPart& part : step_plan) {
      const std::int64_t entries = of_ranks[static_cast<std::size_t>(part.rank)].record.entries[part.view];
      work[static_cast<std::size_t>(part.rank)] += entries;
      equal_work[static_cast<std::size_t>(in_turn[part.view])] += entries;
      draw_plan.set_work(views[part.view].view_index, entries);
    }
  }
  rank_load.add_step(work, equal_work);
}

void Trainer::Impl::add_drawn(const std::vector<DrawnParts>& of_ranks) {
  const std::vector<UnreadLoss> unread = std::exchange(unread_losses, {});
  if (unread.empty()) return;
  count_drawn(unread, of_ranks);
  std::vector<RankTotals> totals;
  for (const DrawnParts& drawn : of_ranks) totals.push_back(drawn.record.totals);
  rank_load.set_totals(totals);
  for (std::size_t v = 0; v < unread.size(); ++v) {
    const auto part = std::find_if(step_plan.begin(), step_plan.end(), [&](const auto& p) { return p.view == v; });
    add_loss(unread[v], of_ranks[static_cast<std::size_t>(part->rank)].record.losses[v]);
  }
}

}  // namespace b3dgs
