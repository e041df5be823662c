// What ranks tell each other of the views that they have drawn in the last step: losses and counted work.

#include <torch/types.h>

#include <numeric>
#include <utility>

#include "train/trainer_impl.h"

namespace b3dgs {

void Trainer::Impl::read_own_loss() {
  if (!own_views.empty() && !own_views.back().loss) own_views.back().loss = loss.value().loss;
}

torch::Tensor Trainer::Impl::queue_row_entries() const {
  const torch::Tensor entries = rasterizer.row_entries();
  if (device.is_cpu()) return entries;
  torch::Tensor on_host = torch::empty(entries.sizes(), torch::dtype(torch::kInt64).pinned_memory(true));
  return on_host.copy_(entries, /*non_blocking=*/true);
}

DrawnRecord Trainer::Impl::take_drawn() {
  read_own_loss();  // queued behind the entries, which are there, too
  DrawnRecord record;
  for (const OwnView& own : std::exchange(own_views, {})) {
    const auto* const entries = own.entries.data_ptr<std::int64_t>();
    record.losses[own.place] = *own.loss;
    record.entries[own.place] = std::accumulate(entries, entries + own.entries.size(0), std::int64_t{0});
  }
  return record;
}

void Trainer::Impl::read_losses_of_ranks() {
  if (!unread_losses.empty()) add_drawn(ranks->exchange_record("drawn", take_drawn()));
}

void Trainer::Impl::add_drawn(const std::vector<DrawnRecord>& of_ranks) {
  const std::vector<UnreadLoss> unread = std::exchange(unread_losses, {});
  for (std::size_t v = 0; v < unread.size(); ++v) {
    const DrawnRecord& of_drawer = of_ranks[static_cast<std::size_t>(step_drawers[v])];
    draw_plan.set_work(unread[v].view_index, of_drawer.entries[v]);
    add_loss(unread[v], of_drawer.losses[v]);
  }
}

}  // namespace b3dgs
