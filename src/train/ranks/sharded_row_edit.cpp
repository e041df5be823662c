#include "train/ranks/sharded_row_edit.h"

#include <torch/types.h>

#include <algorithm>
#include <string>
#include <vector>

#include "core/check.h"

namespace b3dgs {
namespace {

/// Tensors whose rows move together: as one row of words, in the first `n_rows` rows of the model after the edit.
struct MovedGroup {
  std::vector<torch::Tensor*> tensors;
  std::int64_t n_rows = 0;
  std::int64_t words_per_row = 0;  // of 32 bits
};

/// Moves rows from the ranks that hold them before an edit to those that hold them afterwards. Which rows move where is
/// found once; a group of tensors then takes one exchange, or one for each piece of it.
class RowMover {
 public:
  RowMover(Communicator& ranks, const torch::Tensor& sources, std::vector<MovedGroup> groups, std::int64_t piece_bytes)
      : ranks_(ranks), shards_(shards_of(ranks)), groups_(std::move(groups)) {
    for (int r = 0; r < shards_.size; ++r) {
      const torch::Tensor of_rank = own_rows(sources, {r, shards_.size});
      const torch::Tensor owners = torch::div(of_rank, RowShards::kBlock, "floor").remainder(shards_.size);
      if (r == shards_.rank) {
        for (int s = 0; s < shards_.size; ++s) receive_.push_back((owners == s).nonzero().flatten());
      }
      const torch::Tensor places = r == shards_.rank ? receive_.back() : (owners == shards_.rank).nonzero().flatten();
      send_.push_back(r == shards_.rank ? receive_[static_cast<std::size_t>(r)] : places);
      send_rows_.push_back(local_rows(of_rank.index_select(0, send_.back())));
    }
    plan_pieces(piece_bytes);
  }

  const std::vector<MovedGroup>& groups() const { return groups_; }

  /// Writes this rank's part of group g after the edit to the first rows of `to`, a tensor for each of the group.
  void move(std::size_t g, const std::vector<torch::Tensor>& to) const {
    for (const Piece& piece : pieces_[g]) move_piece(groups_[g], piece, to);
  }

 private:
  struct Span {
    std::int64_t begin = 0, end = 0;
    std::int64_t size() const { return end - begin; }
  };
  /// Rows [begin, end) of every rank after the edit: parts of the lists below.
  struct Piece {
    std::vector<Span> send, receive;  // by rank
  };

  torch::Tensor local_rows(const torch::Tensor& sources) const {
    const torch::Tensor local_blocks = torch::div(sources, RowShards::kBlock * shards_.size, "floor");
    return local_blocks * RowShards::kBlock + sources.remainder(RowShards::kBlock);
  }

  /// Where the pieces of all groups begin and end in the lists. Waits for the device once.
  void plan_pieces(std::int64_t piece_bytes) {
    std::vector<std::int64_t> rows_per;
    for (const MovedGroup& group : groups_) {
      const std::int64_t bytes = RowShards::kBlock * std::max<std::int64_t>(1, group.words_per_row) * 4;
      rows_per.push_back(RowShards::kBlock * std::max<std::int64_t>(1, piece_bytes / bytes));
    }
    // Ends of the pieces on a rank, and how many places of a list are before each.
    const auto ends_on = [&](int rank) {
      std::vector<std::int64_t> ends;
      for (std::size_t g = 0; g < groups_.size(); ++g) {
        const std::int64_t n = groups_[g].n_rows, n_own = RowShards{rank, shards_.size}.n_local(n);
        for (std::int64_t end = 0; end < RowShards{0, shards_.size}.n_local(n); end += rows_per[g]) {
          ends.push_back(std::min(end + rows_per[g], n_own));
        }
      }
      return ends;
    };
    std::vector<torch::Tensor> found;
    const auto look_up = [&](const torch::Tensor& places, int rank) {
      found.push_back(torch::searchsorted(places, torch::tensor(ends_on(rank), places.options())));
    };
    for (int r = 0; r < shards_.size; ++r) look_up(send_[static_cast<std::size_t>(r)], r);
    for (const torch::Tensor& places : receive_) look_up(places, shards_.rank);
    const torch::Tensor offsets = torch::stack(found).cpu();
    const auto at = offsets.accessor<std::int64_t, 2>();
    const auto n_lists = static_cast<std::size_t>(shards_.size);
    std::int64_t column = 0;
    for (std::size_t g = 0; g < groups_.size(); ++g) {
      std::vector<Piece>& pieces = pieces_.emplace_back();
      const std::int64_t n_most = RowShards{0, shards_.size}.n_local(groups_[g].n_rows);
      for (std::int64_t begin = 0; begin < n_most; begin += rows_per[g], ++column) {
        Piece& piece = pieces.emplace_back();
        for (std::size_t i = 0; i < 2 * n_lists; ++i) {
          const auto list = static_cast<std::int64_t>(i);
          const Span span{begin == 0 ? 0 : at[list][column - 1], at[list][column]};
          (i < n_lists ? piece.send : piece.receive).push_back(span);
        }
      }
    }
  }

  /// The parts of some lists, one after the other.
  static torch::Tensor joined(const std::vector<torch::Tensor>& lists, const std::vector<Span>& spans) {
    std::vector<torch::Tensor> parts;
    for (std::size_t i = 0; i < lists.size(); ++i) parts.push_back(lists[i].slice(0, spans[i].begin, spans[i].end));
    return torch::cat(parts);
  }

  void move_piece(const MovedGroup& group, const Piece& piece, const std::vector<torch::Tensor>& to) const {
    std::vector<std::int64_t> send, receive;
    for (const Span& span : piece.send) send.push_back(span.size());
    for (const Span& span : piece.receive) receive.push_back(span.size());
    const torch::Tensor rows = joined(send_rows_, piece.send), places = joined(receive_, piece.receive);
    std::vector<torch::Tensor> columns;
    for (const torch::Tensor* tensor : group.tensors) columns.push_back(as_words(*tensor).index_select(0, rows));
    const torch::Tensor sent = columns.size() == 1 ? columns[0] : torch::cat(columns, 1);
    columns.clear();
    const torch::Tensor received = ranks_.all_to_all_rows(sent, send, receive);
    std::int64_t column = 0;
    for (const torch::Tensor& tensor : to) {
      const std::int64_t n_words = words_per_row(tensor);
      as_words(tensor).index_copy_(0, places, received.slice(1, column, column + n_words));
      column += n_words;
    }
  }

  Communicator& ranks_;
  RowShards shards_;
  std::vector<MovedGroup> groups_;
  std::vector<std::vector<Piece>> pieces_;  // by group
  // Rows of a rank after the edit that come from another, ascending: places of each rank's rows that come from here, by
  // rank, and their rows here; places of own rows, by the rank that they come from.
  std::vector<torch::Tensor> send_, send_rows_, receive_;
};

/// Adds tensors to the last group, or begins new ones, so that none has more than `max_bytes` on a rank after the edit,
/// unless it is a single tensor.
void add_groups(const std::vector<torch::Tensor*>& tensors, std::int64_t n_rows, std::int64_t n_most,
                std::int64_t max_bytes, std::vector<MovedGroup>& groups) {
  for (torch::Tensor* tensor : tensors) {
    const std::int64_t n_words = words_per_row(*tensor);
    if (groups.empty() || groups.back().n_rows != n_rows ||
        (groups.back().words_per_row + n_words) * 4 * n_most > max_bytes) {
      groups.push_back({{}, n_rows, 0});
    }
    groups.back().tensors.push_back(tensor);
    groups.back().words_per_row += n_words;
  }
}

/// Numbers that tell edits apart.
struct SourceNumbers {
  std::int64_t first = 0, last = 0;  // smallest and largest source
  std::int64_t weighted_sum = 0;
};

/// Waits for the device once.
SourceNumbers numbers_of(const torch::Tensor& sources) {
  if (sources.numel() == 0) return {};
  const torch::Tensor weights = torch::arange(1, sources.size(0) + 1, sources.options());
  const torch::Tensor numbers = torch::stack({sources.min(), sources.max(), (sources * weights).sum()}).cpu();
  const auto* const values = numbers.data_ptr<std::int64_t>();
  return {values[0], values[1], values[2]};
}

/// Why the edit does not fit this rank's tensors; "" if it does.
std::string find_misfit(const RowEdit& edit, const SourceNumbers& numbers, std::int64_t n_before, std::int64_t n_local,
                        const std::vector<torch::Tensor*>& tensors) {
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
  if (edit.sources.numel() > 0 && (numbers.first < 0 || numbers.last >= n_before)) {
    return detail::concat("sources of the edit are from ", numbers.first, " to ", numbers.last, ", but there are ",
                          n_before, " Gaussians");
  }
  return "";
}

/// Numbers that decide what is exchanged; those of different edits are different, but for rare cases.
std::vector<std::int64_t> identify(const RowEdit& edit, const SourceNumbers& numbers, std::int64_t n_before,
                                   const GaussianTensors& gaussians, const DensityStatistics& statistics) {
  return {n_before,
          edit.sources.size(0),
          edit.n_kept,
          numbers.weighted_sum,
          static_cast<std::int64_t>(edit.copies_moments),
          static_cast<std::int64_t>(edit.new_logit_opacities.defined()),
          gaussians.shN.size(1),
          static_cast<std::int64_t>(statistics.extra.size())};
}

}  // namespace

void apply_row_edit(Communicator& ranks, const RowEdit& edit, std::int64_t n_global_before, GaussianTensors& gaussians,
                    AdamState& adam, DensityStatistics& statistics, std::int64_t piece_bytes) {
  const RowShards shards = shards_of(ranks);
  std::vector<torch::Tensor*> parameters, moments, columns = statistics.all(), tensors;
  for (torch::Tensor* tensor : gaussians.all()) parameters.push_back(tensor);
  for (GaussianTensors* of : {&adam.m, &adam.v}) {
    for (torch::Tensor* tensor : of->all()) moments.push_back(tensor);
  }
  for (const auto* group : {&parameters, &moments, &columns}) {
    tensors.insert(tensors.end(), group->begin(), group->end());
  }
  const SourceNumbers numbers = numbers_of(edit.sources);
  check_together(ranks, "row edit", identify(edit, numbers, n_global_before, gaussians, statistics),
                 find_misfit(edit, numbers, n_global_before, shards.n_local(n_global_before), tensors));
  if (ranks.size() == 1) return apply_row_edit(edit, gaussians, adam, statistics);

  const std::int64_t n_after = edit.sources.size(0);
  const std::int64_t n_own = shards.n_local(n_after), n_own_kept = shards.n_local(edit.n_kept);
  // All ranks form the same groups. Beside the model, memory holds one group, of which all but one are small.
  const std::int64_t n_most = RowShards{0, shards.size}.n_local(n_after);
  std::int64_t max_bytes = piece_bytes;
  for (const torch::Tensor* tensor : tensors) max_bytes = std::max(max_bytes, n_most * bytes_per_row(*tensor));
  std::vector<MovedGroup> groups;
  add_groups(parameters, n_after, n_most, max_bytes, groups);
  add_groups(moments, edit.copies_moments ? n_after : edit.n_kept, n_most, max_bytes, groups);
  add_groups(columns, edit.n_kept, n_most, max_bytes, groups);
  const RowMover mover(ranks, edit.sources, std::move(groups), piece_bytes);
  for (std::size_t g = 0; g < mover.groups().size(); ++g) {
    const MovedGroup& group = mover.groups()[g];
    const std::int64_t n_moved = shards.n_local(group.n_rows);
    std::vector<torch::Tensor> edited;
    for (const torch::Tensor* tensor : group.tensors) {
      std::vector<std::int64_t> sizes = tensor->sizes().vec();
      sizes[0] = n_own;
      edited.push_back(allocate_tensor(sizes, tensor->options()));
      if (n_moved < n_own) edited.back().slice(0, n_moved).zero_();
    }
    mover.move(g, edited);
    for (std::size_t i = 0; i < edited.size(); ++i) *group.tensors[i] = edited[i];
  }
  const torch::Tensor own_new = global_rows(shards, n_after, edit.sources.device()).slice(0, n_own_kept) - edit.n_kept;
  gaussians.means.slice(0, n_own_kept).copy_(edit.new_means.index_select(0, own_new));
  gaussians.log_scales.slice(0, n_own_kept).copy_(edit.new_log_scales.index_select(0, own_new));
  if (edit.new_logit_opacities.defined()) {
    gaussians.logit_opacities.slice(0, n_own_kept).copy_(edit.new_logit_opacities.index_select(0, own_new));
  }
  gaussians.filters = torch::Tensor();
}

}  // namespace b3dgs
