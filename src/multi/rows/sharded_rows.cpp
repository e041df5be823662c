#include "multi/rows/sharded_rows.h"

#include <torch/types.h>

#include <algorithm>
#include <cstring>
#include <exception>
#include <utility>

#include "core/check.h"
#include "train/density/row_edit.h"

namespace b3dgs {
namespace {

std::vector<std::int64_t> sizes_with_rows(const torch::Tensor& tensor, std::int64_t n_rows) {
  std::vector<std::int64_t> sizes = tensor.sizes().vec();
  sizes[0] = n_rows;
  return sizes;
}

void check_own_rows(Communicator& ranks, const std::vector<torch::Tensor>& tensors, const RowOwners& owners) {
  std::vector<std::int64_t> shapes{owners.n_rows()};
  shapes.insert(shapes.end(), owners.n_of_ranks().begin(), owners.n_of_ranks().end());
  std::string cause;
  for (const torch::Tensor& own : tensors) {
    B3DGS_CHECK(own.defined() && own.dim() >= 1 && own.is_contiguous(), "expected a contiguous tensor with rows");
    const std::vector<std::int64_t> shape = sizes_with_rows(own, owners.n_rows());
    shapes.insert(shapes.end(), shape.begin(), shape.end());
    shapes.push_back(static_cast<std::int64_t>(own.scalar_type()));
    if (own.size(0) != owners.n_own()) {
      cause = detail::concat("a tensor has ", own.size(0), " rows of ", owners.n_rows(), ", expected ", owners.n_own());
    }
  }
  check_together(ranks, "number of rows, shape or type of a tensor", shapes, cause);
}

/// What the ranks exchange at a time: a range of rows of the model.
struct Piece {
  std::int64_t begin = 0, end = 0;
  std::int64_t own_begin = 0;        // its first row among the own rows
  std::vector<std::int64_t> counts;  // of each rank
};

/// Pieces of about `n_rows` on each rank. Waits for the device if there are several.
std::vector<Piece> pieces_of(std::int64_t n_rows, const RowOwners& owners) {
  const std::int64_t n_all = owners.n_rows(), n_piece = n_rows * owners.size();
  if (n_all == 0) return {};
  if (n_all <= n_piece) return {{0, n_all, 0, owners.n_of_ranks()}};
  std::vector<torch::Tensor> sums;
  std::vector<Piece> pieces;
  for (std::int64_t begin = 0; begin < n_all; begin += n_piece) {
    pieces.push_back({begin, std::min(begin + n_piece, n_all), 0, {}});
    const torch::Tensor of_rows = owners.owners().slice(0, begin, pieces.back().end);
    for (int r = 0; r < owners.size(); ++r) sums.push_back((of_rows == r).sum());
  }
  const torch::Tensor on_host = torch::stack(sums).cpu();
  const auto* counts = on_host.data_ptr<std::int64_t>();
  std::int64_t own_begin = 0;
  for (Piece& piece : pieces) {
    piece.counts.assign(counts, counts + owners.size());
    piece.own_begin = own_begin;
    own_begin += counts[owners.rank()];
    counts += owners.size();
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
  gathered.received =
      ranks.all_gather_rows(part, std::vector<std::int64_t>(static_cast<std::size_t>(ranks.size()), n_most));
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
  if (owners.size() == 1) return whole.clone(torch::MemoryFormat::Contiguous);
  return whole.index_select(0, owners.own().to(whole.device()));
}

torch::Tensor gather_rows(Communicator& ranks, const torch::Tensor& own, const RowOwners& owners,
                          std::int64_t piece_bytes) {
  check_own_rows(ranks, {own}, owners);
  if (ranks.size() == 1) return own;
  torch::Tensor whole = torch::empty(sizes_with_rows(own, owners.n_rows()), own.options());
  for (const Piece& piece : pieces_of(rows_per_piece(bytes_per_row(own), piece_bytes), owners)) {
    const GatheredPiece gathered = gather_piece(ranks, piece, own_rows_of(piece, own, owners), owners);
    torch::Tensor rows = whole.slice(0, piece.begin, piece.end);
    torch::index_select_out(rows, gathered.received, 0, gathered.places);
  }
  return whole;
}

std::vector<torch::Tensor> gather_rows(Communicator& ranks, const std::vector<torch::Tensor>& own,
                                       const RowOwners& owners, std::int64_t piece_bytes) {
  check_own_rows(ranks, own, owners);
  if (ranks.size() == 1 || own.empty()) return own;
  std::vector<torch::Tensor> whole;
  std::int64_t n_words = 0;
  for (const torch::Tensor& tensor : own) {
    whole.push_back(torch::empty(sizes_with_rows(tensor, owners.n_rows()), tensor.options()));
    n_words += words_per_row(tensor);
  }
  const std::int64_t bytes = n_words * static_cast<std::int64_t>(sizeof(std::int32_t));
  for (const Piece& piece : pieces_of(rows_per_piece(bytes, piece_bytes), owners)) {
    std::vector<torch::Tensor> columns;
    for (const torch::Tensor& tensor : own) columns.push_back(own_rows_of(piece, as_words(tensor), owners));
    const GatheredPiece gathered = gather_piece(ranks, piece, torch::cat(columns, 1), owners);
    std::int64_t column = 0;
    for (const torch::Tensor& tensor : whole) {
      const std::int64_t end = column + words_per_row(tensor);
      torch::Tensor rows = as_words(tensor).slice(0, piece.begin, piece.end);
      torch::index_select_out(rows, gathered.received.slice(1, column, end), 0, gathered.places);
      column = end;
    }
  }
  return whole;
}

void stream_rows_to_first(Communicator& ranks, const torch::Tensor& own, const RowOwners& owners,
                          const std::function<void(const torch::Tensor& rows)>& take, std::int64_t piece_bytes) {
  check_own_rows(ranks, {own}, owners);
  if (ranks.size() == 1) return take(own.cpu());
  std::exception_ptr fault;
  const std::vector<std::int64_t> none(static_cast<std::size_t>(ranks.size()), 0);
  for (const Piece& piece : pieces_of(rows_per_piece(bytes_per_row(own), piece_bytes), owners)) {
    const torch::Tensor rows = own_rows_of(piece, own, owners);
    std::vector<std::int64_t> send = none;
    send[0] = rows.size(0);
    const torch::Tensor received = ranks.all_to_all_rows(rows, send, ranks.is_first() ? piece.counts : none);
    if (!ranks.is_first() || fault) continue;
    torch::Tensor ordered = torch::empty(sizes_with_rows(own, received.size(0)), own.options().device(torch::kCPU));
    ordered.index_copy_(0, rows_by_rank(piece, owners).cpu(), received.cpu());
    try {
      take(ordered);
    } catch (...) {
      fault = std::current_exception();  // the other ranks do not know
    }
  }
  if (fault) std::rethrow_exception(fault);
}

torch::Tensor gather_rows_on_first(Communicator& ranks, const torch::Tensor& own, const RowOwners& owners,
                                   std::int64_t piece_bytes) {
  if (ranks.size() == 1) {
    check_own_rows(ranks, {own}, owners);
    return own.cpu();
  }
  torch::Tensor whole;
  std::int64_t n_taken = 0;
  if (ranks.is_first() && own.defined() && own.dim() >= 1) {
    whole = torch::empty(sizes_with_rows(own, owners.n_rows()), own.options().device(torch::kCPU));
  }
  stream_rows_to_first(
      ranks, own, owners,
      [&](const torch::Tensor& rows) {
        whole.slice(0, n_taken, n_taken + rows.size(0)).copy_(rows);
        n_taken += rows.size(0);
      },
      piece_bytes);
  return whole;
}

torch::Tensor gather_view_rows(Communicator& ranks, const torch::Tensor& rendered, const std::vector<int>& renderers) {
  std::vector<std::int64_t> counts(static_cast<std::size_t>(ranks.size()), 0), places;
  for (const int renderer : renderers) places.push_back(counts.at(static_cast<std::size_t>(renderer))++);
  const std::int64_t n_own = counts[static_cast<std::size_t>(ranks.rank())];
  B3DGS_CHECK(rendered.size(0) == n_own, rendered.size(0), " rows of ", n_own, " views that this rank renders");
  if (ranks.size() == 1) return rendered;
  const std::int64_t n_most = *std::max_element(counts.begin(), counts.end());  // parts of one size are faster
  torch::Tensor part = torch::zeros(sizes_with_rows(rendered, n_most), rendered.options());
  part.slice(0, 0, n_own).copy_(rendered);
  std::fill(counts.begin(), counts.end(), n_most);
  const torch::Tensor all = ranks.all_gather_rows(part, counts);
  for (std::size_t v = 0; v < renderers.size(); ++v) places[v] += renderers[v] * n_most;
  return all.index_select(0, torch::tensor(places, torch::kInt64).to(all.device()));
}

std::int64_t bytes_per_row(const torch::Tensor& rows) {
  std::int64_t bytes = static_cast<std::int64_t>(rows.element_size());
  for (std::int64_t axis = 1; axis < rows.dim(); ++axis) bytes *= rows.size(axis);
  return bytes;
}

std::int64_t words_per_row(const torch::Tensor& rows) {
  B3DGS_CHECK(rows.element_size() == sizeof(std::int32_t), "a tensor of ", rows.element_size(), "-byte elements");
  return bytes_per_row(rows) / static_cast<std::int64_t>(sizeof(std::int32_t));
}

torch::Tensor as_words(const torch::Tensor& rows) {
  return rows.view({rows.size(0), words_per_row(rows)}).view(torch::kInt32);
}

std::int64_t rows_per_piece(std::int64_t bytes, std::int64_t piece_bytes) {
  return std::max<std::int64_t>(1, piece_bytes / std::max<std::int64_t>(1, bytes));
}

void throw_together(Communicator& ranks, const std::string& label, const std::string& cause) {
  const std::vector<std::string> causes = ranks.exchange(label, cause);
  for (int r = 0; r < ranks.size(); ++r) {
    const std::string& first = causes[static_cast<std::size_t>(r)];
    B3DGS_CHECK(first.empty(), "rank ", r, " of ", ranks.size(), ": ", first);
  }
}

void check_together(Communicator& ranks, const std::string& what, const std::vector<std::int64_t>& numbers,
                    const std::string& cause) {
  // How many bytes the numbers take, the numbers, the cause.
  const auto n_bytes = static_cast<std::int64_t>(numbers.size() * sizeof(std::int64_t));
  std::string record(reinterpret_cast<const char*>(&n_bytes), sizeof n_bytes);
  record.append(reinterpret_cast<const char*>(numbers.data()), static_cast<std::size_t>(n_bytes));
  const std::vector<std::string> all = ranks.exchange(what, record + cause);
  const auto size_of_numbers = [&](const std::string& of) {
    std::int64_t n = 0;
    std::memcpy(&n, of.data(), sizeof n);
    return sizeof n + static_cast<std::size_t>(n);
  };
  // A cause says more than that ranks disagree, which it often brings about.
  for (int r = 0; r < ranks.size(); ++r) {
    const std::string& of_rank = all[static_cast<std::size_t>(r)];
    const std::string found = of_rank.substr(size_of_numbers(of_rank));
    B3DGS_CHECK(found.empty(), "rank ", r, " of ", ranks.size(), ": ", found);
  }
  for (int r = 1; r < ranks.size(); ++r) {
    B3DGS_CHECK(all[static_cast<std::size_t>(r)] == all[0], "rank ", r, " of ", ranks.size(),
                " and rank 0 disagree on the ", what);
  }
}

void check_agreement(Communicator& ranks, const std::string& what, const std::vector<std::int64_t>& numbers) {
  const auto* bytes = reinterpret_cast<const char*>(numbers.data());
  const std::vector<std::string> all = ranks.exchange(what, std::string(bytes, numbers.size() * sizeof(std::int64_t)));
  for (int r = 1; r < ranks.size(); ++r) {
    B3DGS_CHECK(all[static_cast<std::size_t>(r)] == all[0], "rank ", r, " of ", ranks.size(),
                " and rank 0 disagree on the ", what);
  }
}

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

void move_group(Communicator& ranks, const MovedGroup& group, const MovedPiece& piece,
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
      const MovedPiece piece = piece_of(before, after, begin, std::min(begin + n_piece, before.n_rows()));
      move_group(ranks, group, piece, moved);
    }
    for (std::size_t i = 0; i < moved.size(); ++i) *group.tensors[i] = moved[i];
  }
}

}  // namespace b3dgs
