#include "train/ranks/sharded_row_edit.h"

#include <torch/torch.h>

#include <algorithm>
#include <string>
#include <vector>

#include "core/check.h"

namespace b3dgs {
namespace {

/// Moves rows from the ranks that hold them before an edit to those that hold them afterwards.
class RowMover {
 public:
  RowMover(Communicator& ranks, const torch::Tensor& sources) : ranks_(ranks), shards_(shards_of(ranks)) {
    for (int r = 0; r < ranks.size(); ++r) sources_.push_back(own_rows(sources, {r, shards_.size}));
  }

  /// Writes this rank's part of the first n rows after the edit to the first rows of `to`.
  void move(const torch::Tensor& from, std::int64_t n, torch::Tensor& to, std::int64_t piece_bytes) const {
    const std::int64_t n_most = RowShards{0, shards_.size}.n_local(n), n_piece = rows_per_piece(from, piece_bytes);
    for (std::int64_t begin = 0; begin < n_most; begin += n_piece) move_piece(from, n, begin, begin + n_piece, to);
  }

 private:
  /// Sources of a rank's rows [begin, end) after the edit, as far as they belong to the first n of all.
  torch::Tensor sources_of(int rank, std::int64_t n, std::int64_t begin, std::int64_t end) const {
    const std::int64_t n_own = RowShards{rank, shards_.size}.n_local(n);
    return sources_[static_cast<std::size_t>(rank)].slice(0, std::min(begin, n_own), std::min(end, n_own));
  }

  /// Places in `sources` of the rows that the rank holds before the edit.
  torch::Tensor places_on(int rank, const torch::Tensor& sources) const {
    const torch::Tensor blocks = torch::div(sources, RowShards::kBlock, "floor");
    return (blocks.remainder(shards_.size) == rank).nonzero().flatten();
  }

  torch::Tensor local_rows(const torch::Tensor& sources) const {
    const torch::Tensor local_blocks = torch::div(sources, RowShards::kBlock * shards_.size, "floor");
    return local_blocks * RowShards::kBlock + sources.remainder(RowShards::kBlock);
  }

  void move_piece(const torch::Tensor& from, std::int64_t n, std::int64_t begin, std::int64_t end,
                  torch::Tensor& to) const {
    std::vector<torch::Tensor> rows, places;
    std::vector<std::int64_t> send, receive;
    const torch::Tensor own_sources = sources_of(shards_.rank, n, begin, end);
    for (int r = 0; r < shards_.size; ++r) {
      const torch::Tensor sources = sources_of(r, n, begin, end);
      rows.push_back(local_rows(sources.index_select(0, places_on(shards_.rank, sources))));
      send.push_back(rows.back().size(0));
      places.push_back(places_on(r, own_sources));
      receive.push_back(places.back().size(0));
    }
    const torch::Tensor received = ranks_.all_to_all_rows(from.index_select(0, torch::cat(rows)), send, receive);
    const std::int64_t first = std::min(begin, to.size(0));
    to.slice(0, first, first + received.size(0)).index_copy_(0, torch::cat(places), received);
  }

  Communicator& ranks_;
  RowShards shards_;
  std::vector<torch::Tensor> sources_;  // by rank: source of each of its rows after the edit
};

/// Why the edit does not fit this rank's tensors; "" if it does.
std::string find_misfit(const RowEdit& edit, std::int64_t n_before, std::int64_t n_local,
                        const std::vector<const torch::Tensor*>& tensors) {
  const std::int64_t n_new = edit.sources.size(0) - edit.n_kept;
  for (const torch::Tensor* tensor : tensors) {
    if (!tensor->defined() || tensor->size(0) != n_local || !tensor->is_contiguous()) {
      return detail::concat("a tensor has ", tensor->defined() ? tensor->size(0) : 0, " rows of ", n_before,
                            " Gaussians, expected ", n_local, ", contiguous");
    }
  }
  const bool has_opacities = edit.new_logit_opacities.defined();
  if (n_new < 0 || edit.n_kept < 0 || edit.new_means.size(0) != n_new || edit.new_log_scales.size(0) != n_new ||
      (has_opacities && edit.new_logit_opacities.size(0) != n_new)) {
    return detail::concat("the edit keeps ", edit.n_kept, " of ", edit.sources.size(0), " rows, but has ",
                          edit.new_means.size(0), " new means");
  }
  if (edit.sources.numel() > 0) {
    const auto first = edit.sources.min().item<std::int64_t>(), last = edit.sources.max().item<std::int64_t>();
    if (first < 0 || last >= n_before) {
      return detail::concat("sources of the edit are from ", first, " to ", last, ", but there are ", n_before,
                            " Gaussians");
    }
  }
  return "";
}

/// Numbers that decide what is exchanged; those of different edits are different, but for rare cases.
std::vector<std::int64_t> identify(const RowEdit& edit, std::int64_t n_before, const GaussianTensors& gaussians,
                                   const DensityStatistics& statistics) {
  const torch::Tensor weights = torch::arange(1, edit.sources.size(0) + 1, edit.sources.options());
  return {n_before,
          edit.sources.size(0),
          edit.n_kept,
          (edit.sources * weights).sum().item<std::int64_t>(),
          static_cast<std::int64_t>(edit.copies_moments),
          static_cast<std::int64_t>(edit.new_logit_opacities.defined()),
          gaussians.shN.size(1),
          static_cast<std::int64_t>(statistics.extra.size())};
}

}  // namespace

void apply_row_edit(Communicator& ranks, const RowEdit& edit, std::int64_t n_global_before, GaussianTensors& gaussians,
                    AdamState& adam, DensityStatistics& statistics, std::int64_t piece_bytes) {
  const RowShards shards = shards_of(ranks);
  std::vector<const torch::Tensor*> tensors;
  for (const GaussianTensors* group : {&gaussians, &adam.m, &adam.v}) {
    for (const torch::Tensor* tensor : group->all()) tensors.push_back(tensor);
  }
  for (const torch::Tensor* tensor : statistics.all()) tensors.push_back(tensor);
  throw_together(ranks, "row edit", find_misfit(edit, n_global_before, shards.n_local(n_global_before), tensors));
  check_agreement(ranks, "row edit", identify(edit, n_global_before, gaussians, statistics));
  if (ranks.size() == 1) return apply_row_edit(edit, gaussians, adam, statistics);

  const std::int64_t n_after = edit.sources.size(0);
  const std::int64_t n_own = shards.n_local(n_after), n_own_kept = shards.n_local(edit.n_kept);
  const RowMover mover(ranks, edit.sources);
  const auto edit_all = [&](auto& group, bool copies_new) {
    for (torch::Tensor* tensor : group.all()) {
      std::vector<std::int64_t> sizes = tensor->sizes().vec();
      sizes[0] = n_own;
      torch::Tensor edited = allocate_tensor(sizes, tensor->options());
      mover.move(*tensor, copies_new ? n_after : edit.n_kept, edited, piece_bytes);
      if (!copies_new) edited.slice(0, n_own_kept).zero_();
      *tensor = edited;
    }
  };
  edit_all(gaussians, true);
  edit_all(adam.m, edit.copies_moments);
  edit_all(adam.v, edit.copies_moments);
  edit_all(statistics, false);
  const torch::Tensor own_new = global_rows(shards, n_after, edit.sources.device()).slice(0, n_own_kept) - edit.n_kept;
  gaussians.means.slice(0, n_own_kept).copy_(edit.new_means.index_select(0, own_new));
  gaussians.log_scales.slice(0, n_own_kept).copy_(edit.new_log_scales.index_select(0, own_new));
  if (edit.new_logit_opacities.defined()) {
    gaussians.logit_opacities.slice(0, n_own_kept).copy_(edit.new_logit_opacities.index_select(0, own_new));
  }
  gaussians.filters = torch::Tensor();
}

}  // namespace b3dgs
