#include "multi/rows/sharded_rows.h"

#include <torch/types.h>

#include <c10/util/accumulate.h>

#include <algorithm>

#include "core/check.h"
#include "train/density/row_edit.h"

namespace b3dgs {
namespace {

std::vector<std::int64_t> sizes_with_rows(const torch::Tensor& tensor, std::int64_t n_rows) {
  std::vector<std::int64_t> sizes = tensor.sizes().vec();
  sizes[0] = n_rows;
  return sizes;
}

void check_own_rows(const torch::Tensor& own, const RowOwners& owners) {
  B3DGS_CHECK(own.defined() && own.is_contiguous() && own.size(0) == owners.n_own(), "expected ", owners.n_own(),
              " contiguous rows of ", owners.n_rows());
}

std::int64_t bytes_per_row(const torch::Tensor& rows) {
  return c10::multiply_integers(rows.sizes().slice(1)) * static_cast<std::int64_t>(rows.element_size());
}

/// How many rows of `bytes` each fit into piece_bytes: at least one.
std::int64_t rows_per_piece(std::int64_t bytes, std::int64_t piece_bytes) {
  return std::max<std::int64_t>(1, piece_bytes / std::max<std::int64_t>(1, bytes));
}

constexpr std::int64_t kWordBytes = sizeof(std::int32_t);

/// The same memory as [n, words of a row] int32.
torch::Tensor as_words(const torch::Tensor& rows) {
  return rows.view({rows.size(0), bytes_per_row(rows) / kWordBytes}).view(torch::kInt32);
}

/// What the ranks exchange at a time: a range of rows of the model.
struct Piece {
  std::int64_t begin = 0, end = 0;
  std::int64_t own_begin = 0;        // its first row among the own rows
  std::vector<std::int64_t> counts;  // of each rank
};

/// Pieces of about `n_rows` on each rank. Waits for the device.
std::vector<Piece> pieces_of(std::int64_t n_rows, const RowOwners& owners) {
  const std::int64_t n_piece = n_rows * owners.size();
  std::vector<Piece> pieces;
  std::int64_t own_begin = 0;
  for (std::int64_t begin = 0; begin < owners.n_rows(); begin += n_piece) {
    const std::int64_t end = std::min(begin + n_piece, owners.n_rows());
    pieces.push_back({begin, end, own_begin, owners.count(begin, end)});
    own_begin += pieces.back().counts[static_cast<std::size_t>(owners.rank())];
  }
  return pieces;
}

torch::Tensor own_rows_of(const Piece& piece, const torch::Tensor& own, const RowOwners& owners) {
  const std::int64_t n = piece.counts[static_cast<std::size_t>(owners.rank())];
  return own.slice(0, piece.own_begin, piece.own_begin + n);
}

/// The rows of the piece, counted from its first, in the order of the ranks.
torch::Tensor rows_by_rank(const Piece& piece, const RowOwners& owners) {
  const torch::Tensor of_rows = owners.owners().slice(0, piece.begin, piece.end);
  return std::get<1>(torch::sort(of_rows, /*stable=*/true, /*dim=*/0, /*descending=*/false));
}

/// A piece as it was received, and where in it each of its rows is, [end - begin] int64.
struct GatheredPiece {
  torch::Tensor received, places;
};

/// @param own  this rank's rows of the piece
GatheredPiece gather_piece(Communicator& ranks, const Piece& piece, const torch::Tensor& own, const RowOwners& owners) {
  const std::int64_t n_most = *std::max_element(piece.counts.begin(), piece.counts.end());
  torch::Tensor part = own;
  if (own.size(0) < n_most) {  // parts of one size are gathered faster
    part = torch::empty(sizes_with_rows(own, n_most), own.options());
    part.slice(0, 0, own.size(0)).copy_(own);
    part.slice(0, own.size(0)).zero_();
  }
  GatheredPiece gathered;
  gathered.received = ranks.all_gather_rows(part);
  const torch::Tensor rows = rows_by_rank(piece, owners);
  std::vector<torch::Tensor> places;
  for (std::size_t r = 0; r < piece.counts.size(); ++r) {
    const auto begin = static_cast<std::int64_t>(r) * n_most;
    places.push_back(torch::arange(begin, begin + piece.counts[r], rows.options()));
  }
  gathered.places = torch::empty_like(rows).index_copy_(0, rows, torch::cat(places));
  return gathered;
}

}  // namespace

torch::Tensor own_rows(const torch::Tensor& whole, const RowOwners& owners) {
  return whole.index_select(0, owners.own().to(whole.device()));
}

std::vector<torch::Tensor> gather_rows(Communicator& ranks, const std::vector<torch::Tensor>& own,
                                       const RowOwners& owners, std::int64_t piece_bytes) {
  std::vector<torch::Tensor> whole;
  std::int64_t bytes = 0;
  for (const torch::Tensor& tensor : own) {
    check_own_rows(tensor, owners);
    whole.push_back(torch::empty(sizes_with_rows(tensor, owners.n_rows()), tensor.options()));
    bytes += bytes_per_row(tensor);
  }
  for (const Piece& piece : pieces_of(rows_per_piece(bytes, piece_bytes), owners)) {
    std::vector<torch::Tensor> columns;
    for (const torch::Tensor& tensor : own) columns.push_back(own_rows_of(piece, as_words(tensor), owners));
    const GatheredPiece gathered = gather_piece(ranks, piece, torch::cat(columns, 1), owners);
    std::int64_t column = 0;
    for (const torch::Tensor& tensor : whole) {
      const std::int64_t end = column + bytes_per_row(tensor) / kWordBytes;
      torch::Tensor rows = as_words(tensor).slice(0, piece.begin, piece.end);
      torch::index_select_out(rows, gathered.received.slice(1, column, end), 0, gathered.places);
      column = end;
    }
  }
  return whole;
}

torch::Tensor gather_rows_on_first(Communicator& ranks, const torch::Tensor& own, const RowOwners& owners,
                                   std::int64_t piece_bytes) {
  check_own_rows(own, owners);
  torch::Tensor whole;
  if (ranks.is_first()) {
    whole = torch::empty(sizes_with_rows(own, owners.n_rows()), own.options().device(torch::kCPU));
  }
  const std::vector<std::int64_t> none(static_cast<std::size_t>(ranks.size()), 0);
  for (const Piece& piece : pieces_of(rows_per_piece(bytes_per_row(own), piece_bytes), owners)) {
    const torch::Tensor rows = own_rows_of(piece, own, owners);
    std::vector<std::int64_t> send = none;
    send[0] = rows.size(0);
    const torch::Tensor received = ranks.all_to_all_rows(rows, send, ranks.is_first() ? piece.counts : none);
    if (!ranks.is_first()) continue;
    whole.slice(0, piece.begin, piece.end).index_copy_(0, rows_by_rank(piece, owners).cpu(), received.cpu());
  }
  return whole;
}

torch::Tensor gather_view_rows(Communicator& ranks, const torch::Tensor& rendered, const std::vector<int>& renderers) {
  std::vector<std::int64_t> counts(static_cast<std::size_t>(ranks.size()), 0), places;
  for (const int renderer : renderers) places.push_back(counts.at(static_cast<std::size_t>(renderer))++);
  const std::int64_t n_own = counts[static_cast<std::size_t>(ranks.rank())];
  B3DGS_CHECK(rendered.size(0) == n_own, rendered.size(0), " rows of ", n_own, " views that this rank renders");
  const std::int64_t n_most = *std::max_element(counts.begin(), counts.end());  // parts of one size are faster
  torch::Tensor part = torch::zeros(sizes_with_rows(rendered, n_most), rendered.options());
  part.slice(0, 0, n_own).copy_(rendered);
  const torch::Tensor all = ranks.all_gather_rows(part);
  for (std::size_t v = 0; v < renderers.size(); ++v) places[v] += renderers[v] * n_most;
  return all.index_select(0, torch::tensor(places, torch::kInt64).to(all.device()));
}

namespace {

/// What this rank sends to and receives from each rank, for a range of rows of the model.
struct MovedPiece {
  torch::Tensor sent;      // own rows before, by rank that they go to
  torch::Tensor received;  // own rows after, by rank that they come from
  std::vector<std::int64_t> n_sent, n_received;
};

/// Rows [begin, end) of the model. Waits for the device.
MovedPiece piece_of(const RowOwners& before, const RowOwners& after, std::int64_t begin, std::int64_t end) {
  const torch::Tensor from = before.owners().slice(0, begin, end), to = after.owners().slice(0, begin, end);
  std::vector<torch::Tensor> sent, received;
  MovedPiece piece;
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

}  // namespace

std::int64_t bytes_to_move_rows(const std::vector<torch::Tensor*>& tensors, const RowOwners& before,
                                const RowOwners& after, std::int64_t piece_bytes) {
  const std::int64_t n_most = std::max(before.n_most(), after.n_most());
  std::int64_t largest = 0, growth = 0;
  for (const torch::Tensor* tensor : tensors) {
    const std::int64_t row = bytes_per_row(*tensor);
    largest = std::max(largest, n_most * row);
    growth += std::max<std::int64_t>(0, after.n_own() - before.n_own()) * row;
  }
  // A tensor exists in its old and its new size at the same time; what it sends and receives lies in pieces, of which a
  // rank may own all rows; tensors before it may have grown.
  return largest + growth + 4 * std::min(piece_bytes * before.size(), largest);
}

void move_rows(Communicator& ranks, const std::vector<torch::Tensor*>& tensors, const RowOwners& before,
               const RowOwners& after, std::int64_t piece_bytes) {
  B3DGS_CHECK(before.n_rows() == after.n_rows(), "rows of ", before.n_rows(), " and of ", after.n_rows());
  for (torch::Tensor* tensor : tensors) {
    const torch::Tensor moved = allocate_tensor(sizes_with_rows(*tensor, after.n_own()), tensor->options());
    const std::int64_t n_piece = rows_per_piece(bytes_per_row(*tensor), piece_bytes) * before.size();
    for (std::int64_t begin = 0; begin < before.n_rows(); begin += n_piece) {
      const MovedPiece piece = piece_of(before, after, begin, std::min(begin + n_piece, before.n_rows()));
      const torch::Tensor sent = tensor->index_select(0, piece.sent);
      moved.index_copy_(0, piece.received, ranks.all_to_all_rows(sent, piece.n_sent, piece.n_received));
    }
    *tensor = moved;
  }
}

}  // namespace b3dgs
