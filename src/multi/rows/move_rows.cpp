#include "multi/rows/move_rows.h"

#include <torch/types.h>

#include <algorithm>

#include "core/check.h"
#include "train/density/row_edit.h"

namespace b3dgs {
namespace {

constexpr std::int64_t kWordBytes = sizeof(std::int32_t);

/// Tensors that are exchanged together, as one row of words.
struct MovedGroup {
  std::vector<torch::Tensor*> tensors;
  std::int64_t words_per_row = 0;
};

/// The same on all ranks. A group is at most as large as the largest tensor or piece_bytes, whichever is more.
std::vector<MovedGroup> groups_of(const std::vector<torch::Tensor*>& tensors, std::int64_t n_most,
                                  std::int64_t piece_bytes) {
  std::int64_t max_bytes = piece_bytes;
  for (const torch::Tensor* tensor : tensors) max_bytes = std::max(max_bytes, n_most * bytes_per_row(*tensor));
  std::vector<MovedGroup> groups;
  for (torch::Tensor* tensor : tensors) {
    const std::int64_t n_words = words_per_row(*tensor);
    if (groups.empty() || (groups.back().words_per_row + n_words) * kWordBytes * n_most > max_bytes)
      groups.push_back({});
    groups.back().tensors.push_back(tensor);
    groups.back().words_per_row += n_words;
  }
  return groups;
}

/// What this rank sends to and receives from each rank, for a range of rows of the model.
struct Piece {
  torch::Tensor sent;      // own rows before, by rank that they go to
  torch::Tensor received;  // own rows after, by rank that they come from
  std::vector<std::int64_t> n_sent, n_received;
};

/// Rows [begin, end) of the model. Waits for the device.
Piece piece_of(const RowOwners& before, const RowOwners& after, std::int64_t begin, std::int64_t end) {
  const torch::Tensor from = before.owners().slice(0, begin, end), to = after.owners().slice(0, begin, end);
  std::vector<torch::Tensor> sent, received;
  Piece piece;
  for (int r = 0; r < before.size(); ++r) {
    sent.push_back((from == before.rank()).logical_and_(to == r).nonzero().flatten());
    received.push_back((to == after.rank()).logical_and_(from == r).nonzero().flatten());
    piece.n_sent.push_back(sent.back().size(0));
    piece.n_received.push_back(received.back().size(0));
  }
  piece.sent = before.own_rows_of(torch::cat(sent).add_(begin));
  piece.received = after.own_rows_of(torch::cat(received).add_(begin));
  return piece;
}

void move_group(Communicator& ranks, const MovedGroup& group, const Piece& piece,
                const std::vector<torch::Tensor>& moved) {
  std::vector<torch::Tensor> columns;
  for (const torch::Tensor* tensor : group.tensors) columns.push_back(as_words(*tensor).index_select(0, piece.sent));
  const torch::Tensor sent = columns.size() == 1 ? columns[0] : torch::cat(columns, 1);
  columns.clear();
  const torch::Tensor received = ranks.all_to_all_rows(sent, piece.n_sent, piece.n_received);
  std::int64_t column = 0;
  for (const torch::Tensor& tensor : moved) {
    const std::int64_t n_words = words_per_row(tensor);
    as_words(tensor).index_copy_(0, piece.received, received.slice(1, column, column + n_words));
    column += n_words;
  }
}

}  // namespace

std::int64_t bytes_to_move_rows(const std::vector<torch::Tensor*>& tensors, const RowOwners& before,
                                const RowOwners& after, std::int64_t piece_bytes) {
  const std::int64_t n_most = std::max(before.n_most(), after.n_most());
  std::int64_t largest = 0, growth = 0;
  for (const MovedGroup& group : groups_of(tensors, n_most, piece_bytes)) {
    const std::int64_t row = group.words_per_row * kWordBytes;
    largest = std::max(largest, n_most * row);
    growth += std::max<std::int64_t>(0, after.n_own() - before.n_own()) * row;
  }
  // Old and new tensors of one group exist at the same time; what it sends and receives lies in pieces, of which a
  // rank may own all rows; groups before it may have grown.
  return largest + growth + 4 * std::min(piece_bytes * before.size(), largest);
}

void move_rows(Communicator& ranks, const std::vector<torch::Tensor*>& tensors, const RowOwners& before,
               const RowOwners& after, std::int64_t piece_bytes) {
  B3DGS_CHECK(before.n_rows() == after.n_rows(), "rows of ", before.n_rows(), " and of ", after.n_rows());
  if (before.size() == 1) return;
  const std::int64_t n_most = std::max(before.n_most(), after.n_most());
  for (const MovedGroup& group : groups_of(tensors, n_most, piece_bytes)) {
    std::vector<torch::Tensor> moved;
    for (const torch::Tensor* tensor : group.tensors) {
      std::vector<std::int64_t> sizes = tensor->sizes().vec();
      sizes[0] = after.n_own();
      moved.push_back(allocate_tensor(sizes, tensor->options()));
    }
    const std::int64_t n_piece = rows_per_piece(group.words_per_row * kWordBytes, piece_bytes) * before.size();
    for (std::int64_t begin = 0; begin < before.n_rows(); begin += n_piece) {
      const Piece piece = piece_of(before, after, begin, std::min(begin + n_piece, before.n_rows()));
      move_group(ranks, group, piece, moved);
    }
    for (std::size_t i = 0; i < moved.size(); ++i) *group.tensors[i] = moved[i];
  }
}

}  // namespace b3dgs
