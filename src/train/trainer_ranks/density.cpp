// Density control of several ranks: each plans the same round, from statistics of the whole model.

#include <algorithm>
#include <utility>

#include "train/density/invalid_gaussians.h"
#include "train/ranks/rows/sharded_row_edit.h"
#include "train/ranks/rows/sharded_rows.h"
#include "train/trainer_impl.h"

namespace b3dgs {

void Trainer::Impl::apply_round_of_ranks(const DensityRound& round, int iteration, std::int64_t limit) {
  SourceNumbers numbers;
  allocate_together([&] { numbers = source_numbers(round.edit); });
  check_row_edit(*ranks, round.edit, numbers, owners, state.gaussians, state.adam, state.statistics);
  OwnRowEdit own;
  allocate_together([&] {
    own = own_part(round.edit, owners);
    const std::int64_t n_own = own.owners.n_own(), n_rows = std::max<std::int64_t>(1, own.owners.n_rows());
    reserve_rows(own.edit, limit > 0 ? std::max<std::int64_t>(1, limit * n_own / n_rows) : 0);
  });
  is_consistent = false;
  row_editor.apply(own.edit, state.gaussians, state.adam, state.statistics);
  owners = std::move(own.owners);
  state.n_of_all_ranks = owners.n_rows();
  density->end_round(iteration, state.statistics);
  is_consistent = true;
}

void Trainer::Impl::allocate_together(const std::function<void()>& work) {
  std::string failure;
  try {
    work();
  } catch (const OutOfMemoryError& error) {
    failure = error.what();
  } catch (const c10::OutOfMemoryError& error) {
    failure = error.what_without_backtrace();
  }
  const std::vector<std::string> failures = ranks->exchange("memory", failure);
  for (std::size_t r = 0; r < failures.size(); ++r) {
    if (!failures[r].empty()) throw_out_of_memory(static_cast<int>(r), failures[r]);
  }
}

void Trainer::Impl::throw_out_of_memory(int rank, const std::string& reason) {
  has_failed_together = true;
  throw OutOfMemoryError(detail::concat("rank ", rank, " of ", ranks->size(), ": ", reason));
}

DensityRound Trainer::Impl::plan_round_of_ranks(int iteration, std::int64_t limit) {
  // Strategies do not read colours.
  GaussianTensors gaussians;
  const GaussianTensors& own = state.gaussians;
  const std::int64_t n = state.n_gaussians();
  allocate_together([&] {
    constexpr std::int64_t kFloats = 3 + 3 + 4 + 1;  // of a Gaussian, without colours
    const auto n_columns = static_cast<std::int64_t>(state.statistics.all().size());
    const torch::Tensor room = memory->allocate({(kFloats + n_columns) * n}, own.means.options());
  });
  DensityStatistics statistics = state.statistics;
  std::vector<torch::Tensor*> gathered{&gaussians.means, &gaussians.log_scales, &gaussians.quats,
                                       &gaussians.logit_opacities};
  std::vector<torch::Tensor> rows{own.means, own.log_scales, own.quats, own.logit_opacities};
  for (torch::Tensor* column : statistics.all()) {
    gathered.push_back(column);
    rows.push_back(*column);
  }
  rows = gather_rows(*ranks, rows, owners);
  for (std::size_t i = 0; i < rows.size(); ++i) *gathered[i] = rows[i];
  DensityRound round;
  allocate_together([&] { round = density->plan_round(gaussians, statistics, iteration, limit); });
  return round;
}

std::int64_t Trainer::Impl::remove_invalid_rows(std::int64_t row) {
  if (!is_distributed()) {
    return b3dgs::remove_invalid_gaussians(row, scene.extent, state.gaussians, state.adam, state.statistics);
  }
  if (renders_on_first) {
    RenderRequest request;
    request.kind = RenderRequest::kRemove;
    request.row = row;
    ranks->exchange_record("render", request);
  }
  const std::int64_t n = state.n_gaussians();
  const GaussianWidths widths = gaussian_widths(state.gaussians, state.adam);
  const RowEdit edit = edit_without_invalid(
      row, scene.extent, {gather_rows(*ranks, widths.is_finite, owners), gather_rows(*ranks, widths.largest, owners)});
  owners = apply_row_edit(*ranks, edit, owners, state.gaussians, state.adam, state.statistics);
  state.n_of_all_ranks = owners.n_rows();
  return n - owners.n_rows();
}

}  // namespace b3dgs
