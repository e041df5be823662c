// The whole model, of which each rank owns some rows. It is distributed at the start and gathered for PLYs and
// checkpoints. In density control, each rank plans the same round from statistics of the whole model.

#include <algorithm>
#include <limits>
#include <set>
#include <utility>
#include <vector>

#include "multi/rank_team.h"
#include "multi/rows.h"
#include "train/checkpoint/checkpoint.h"
#include "train/density/row_edit.h"
#include "train/density_control.h"

namespace b3dgs {

namespace {

/// Returns all tensors with a row per Gaussian.
std::vector<torch::Tensor*> row_tensors(TrainState& state) {
  std::vector<torch::Tensor*> tensors;
  const auto add = [&](torch::Tensor& tensor) {
    if (tensor.defined()) tensors.push_back(&tensor);
  };
  visit_rows(state.gaussians, state.adam, state.statistics, add);
  add(state.gaussians.filters);
  return tensors;
}

/// Returns a checksum of an edit. Waits for the device.
std::int64_t checksum_of(const RowEdit& edit) {
  const torch::Tensor weights = torch::arange(1, edit.sources.size(0) + 1, edit.sources.options());
  return 31 * ((edit.sources + 1) * weights).sum().item<std::int64_t>() + edit.n_kept;
}

}  // namespace

std::string RankTeam::lack_of_memory(const std::function<void()>& work) {
  try {
    work();
  } catch (const OutOfMemoryError& error) {
    return error.what();
  } catch (const c10::OutOfMemoryError& error) {
    return error.what_without_backtrace();
  }
  return "";
}

void RankTeam::distribute_model() {
  const torch::Device device = training_.device;
  state_.n_of_all_ranks = state_.gaussians.size();
  owners_ = RowOwners::round_robin(ranks_.rank(), ranks_.size(), state_.gaussians.size(), device);
  for (torch::Tensor* tensor : row_tensors(state_)) *tensor = own_rows(*tensor, owners_).to(device);
  // Every rank has the whole appearance state.
  visit_appearance(state_.appearance, [&](const char*, torch::Tensor& tensor) { tensor = tensor.to(device); });
}

GaussianTensors RankTeam::gather_gaussians() {
  GaussianTensors whole = training_.flushed_state().gaussians;
  for (torch::Tensor* tensor : whole.all()) *tensor = gather_rows_on_first(ranks_, *tensor, owners_);
  if (whole.filters.defined()) whole.filters = gather_rows_on_first(ranks_, whole.filters, owners_);
  return whole;
}

void RankTeam::write_checkpoint() {
  const TrainState& own = training_.flushed_state();
  std::set<const void*> rows;  // tensors that are distributed over the ranks
  for (const torch::Tensor* tensor : row_tensors(state_)) rows.insert(tensor->unsafeGetTensorImpl());
  std::vector<CheckpointTensor> tensors = checkpoint_tensors(own);
  std::size_t n_read = 0;  // all ranks read all tensors in the same order, even if rank 0 cannot write them
  for (CheckpointTensor& tensor : tensors) {
    const bool has_part = rows.count(tensor.values.unsafeGetTensorImpl()) > 0;
    if (has_part) tensor.entry.shape[0] = state_.n_gaussians();
    tensor.read = [this, has_part, &n_read, part = std::exchange(tensor.values, {})](const TakePiece& take) {
      ++n_read;
      const torch::Tensor whole = has_part ? gather_rows_on_first(ranks_, part, owners_) : part.cpu();
      if (whole.defined()) take(whole.data_ptr(), whole.nbytes());
    };
  }
  on_first(
      [&] { training_.recorder.write_checkpoint(checkpoint_header(config_, own, training_.fingerprint), tensors); });
  while (n_read < tensors.size()) tensors[n_read].read([](const void*, std::size_t) {});
}

void RankTeam::run_round(int iteration, std::int64_t limit,
                         const std::function<void(const DensityRound&)>& on_planned) {
  const DensityRound round = plan_round(iteration, limit);
  on_planned(round);
  OwnRowEdit own;
  allocate_together([&] {
    own = own_part(round.edit, owners_);
    const std::int64_t n_own = own.owners.n_own(), n_rows = std::max<std::int64_t>(1, own.owners.n_rows());
    reserve_rows(training_, own.edit, limit > 0 ? std::max<std::int64_t>(1, limit * n_own / n_rows) : 0);
  });
  apply_reserved(training_, own.edit, iteration);
  owners_ = std::move(own.owners);
  state_.n_of_all_ranks = owners_.n_rows();
  model_ratios_.begin_round();
}

void RankTeam::allocate_together(const std::function<void()>& work) {
  can_save_ = false;
  const std::vector<std::string> failures = ranks_.exchange("memory", lack_of_memory(work));
  for (std::size_t r = 0; r < failures.size(); ++r) {
    if (!failures[r].empty()) throw_out_of_memory(r, failures[r]);
  }
}

void RankTeam::throw_out_of_memory(std::size_t rank, const std::string& reason) {
  can_save_ = true;
  throw OutOfMemoryError(detail::concat("rank ", rank, " of ", ranks_.size(), ": ", reason));
}

DensityRound RankTeam::plan_round(int iteration, std::int64_t limit) {
  const std::int64_t n = state_.n_gaussians();
  DensityStatistics statistics = state_.statistics;
  std::vector<torch::Tensor*> rows = statistics.all();
  allocate_together([&] {
    constexpr std::int64_t kFloats = 3 + 3 + 4 + 1;  // per Gaussian, without colours
    training_.memory->allocate({(kFloats + static_cast<std::int64_t>(rows.size())) * n},
                               state_.gaussians.means.options());
  });
  const GaussianTensors& own = state_.gaussians;
  GaussianTensors gaussians{own.means, own.log_scales, own.quats, own.logit_opacities, {}, {}};  // colours are not read
  rows.insert(rows.end(), {&gaussians.means, &gaussians.log_scales, &gaussians.quats, &gaussians.logit_opacities});
  for (torch::Tensor* tensor : rows) *tensor = gather_rows(ranks_, *tensor, owners_);
  DensityRound round;
  std::int64_t checksum = 0;
  allocate_together([&] {
    round = training_.density->plan_round(gaussians, statistics, iteration, limit);
    checksum = checksum_of(round.edit);
  });
  const std::vector<std::int64_t> checksums = ranks_.exchange_record("round", checksum);
  for (std::size_t r = 1; r < checksums.size(); ++r) {
    B3DGS_CHECK(checksums[r] == checksums[0], "rank ", r, " of ", ranks_.size(), " and rank 0 plan different rounds");
  }
  return round;
}

std::int64_t RankTeam::remove_invalid_rows(std::int64_t row) {
  if (renders_on_first_) {
    RenderRequest request;
    request.kind = RenderRequest::kRemove;
    request.row = row;
    ranks_.exchange_record("render", request);
  }
  const std::int64_t n = state_.n_gaussians();
  const GaussianWidths own = gaussian_widths(state_.gaussians, state_.adam);
  const RowEdit edit =
      edit_without_invalid(row, training_.scene.extent,
                           {gather_rows(ranks_, own.is_finite, owners_), gather_rows(ranks_, own.largest, owners_)});
  OwnRowEdit part = own_part(edit, owners_);
  apply_row_edit(part.edit, state_.gaussians, state_.adam, state_.statistics);
  owners_ = std::move(part.owners);
  state_.n_of_all_ranks = owners_.n_rows();
  return n - owners_.n_rows();
}

}  // namespace b3dgs
