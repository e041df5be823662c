#include "train/ranks/sharded_rows.h"

#include <torch/types.h>

#include <algorithm>
#include <cstring>
#include <exception>
#include <utility>

#include "core/check.h"

namespace b3dgs {
namespace {

std::vector<std::int64_t> sizes_with_rows(const torch::Tensor& tensor, std::int64_t n_rows) {
  std::vector<std::int64_t> sizes = tensor.sizes().vec();
  sizes[0] = n_rows;
  return sizes;
}

void check_local_rows(Communicator& ranks, const std::vector<torch::Tensor>& tensors, std::int64_t n_global) {
  const std::int64_t expected = shards_of(ranks).n_local(n_global);
  std::vector<std::int64_t> shapes{n_global};
  std::string cause;
  for (const torch::Tensor& local : tensors) {
    B3DGS_CHECK(local.defined() && local.dim() >= 1 && local.is_contiguous(), "expected a contiguous tensor with rows");
    const std::vector<std::int64_t> shape = sizes_with_rows(local, n_global);
    shapes.insert(shapes.end(), shape.begin(), shape.end());
    shapes.push_back(static_cast<std::int64_t>(local.scalar_type()));
    if (local.size(0) != expected) {
      cause = detail::concat("a tensor has ", local.size(0), " rows of ", n_global, ", expected ", expected);
    }
  }
  check_together(ranks, "number of rows, shape or type of a tensor", shapes, cause);
}

/// What the ranks exchange at a time: the same local rows of each, which together are a range of global rows.
struct Piece {
  std::int64_t begin = 0, end = 0;   // global rows
  std::int64_t local_begin = 0;      // on every rank
  std::vector<std::int64_t> counts;  // of each rank
};

/// `n_rows`: of each rank in a piece.
std::vector<Piece> pieces_of(std::int64_t n_rows, std::int64_t n_global, int size) {
  std::vector<Piece> pieces;
  for (std::int64_t begin = 0; begin < n_global; begin += n_rows * size) {
    Piece piece{begin, std::min(begin + n_rows * size, n_global), begin / size, {}};
    // A piece starts with a block of rank 0, so its rows are dealt like those of a table of their own.
    for (int r = 0; r < size; ++r) piece.counts.push_back(RowShards{r, size}.n_local(piece.end - piece.begin));
    pieces.push_back(std::move(piece));
  }
  return pieces;
}

torch::Tensor rows_of_rank(const Piece& piece, const torch::Tensor& local, int rank) {
  return local.slice(0, piece.local_begin, piece.local_begin + piece.counts[static_cast<std::size_t>(rank)]);
}

/// Places in the piece of its rows in the order of the ranks.
torch::Tensor places_in_piece(const Piece& piece, torch::Device device) {
  const int size = static_cast<int>(piece.counts.size());
  std::vector<torch::Tensor> rows;
  rows.reserve(piece.counts.size());
  for (int r = 0; r < size; ++r) rows.push_back(global_rows({r, size}, piece.end - piece.begin, device));
  return torch::cat(rows);
}

/// Copies rows in the order of the ranks to their places in `global`.
void put_in_order(const Piece& piece, const torch::Tensor& by_rank, torch::Tensor& global) {
  global.slice(0, piece.begin, piece.end).index_copy_(0, places_in_piece(piece, global.device()), by_rank);
}

}  // namespace

RowShards shards_of(const Communicator& ranks) {
  return {ranks.rank(), ranks.size()};
}

torch::Tensor global_rows(const RowShards& shards, std::int64_t n_global, torch::Device device) {
  torch::Tensor rows = torch::arange(shards.n_local(n_global), torch::dtype(torch::kInt64).device(device));
  if (shards.size == 1) return rows;
  const torch::Tensor blocks = torch::div(rows, RowShards::kBlock, "floor");
  // l + (b (size - 1) + rank) kBlock for row l of local block b
  return rows.add_(blocks, (shards.size - 1) * RowShards::kBlock).add_(shards.rank * RowShards::kBlock);
}

torch::Tensor own_rows(const torch::Tensor& global, const RowShards& shards) {
  if (shards.size == 1) return global.clone(torch::MemoryFormat::Contiguous);
  return global.index_select(0, global_rows(shards, global.size(0), global.device()));
}

torch::Tensor gather_rows(Communicator& ranks, const torch::Tensor& local, std::int64_t n_global,
                          std::int64_t piece_bytes) {
  check_local_rows(ranks, {local}, n_global);
  if (ranks.size() == 1) return local;
  torch::Tensor global = torch::empty(sizes_with_rows(local, n_global), local.options());
  for (const Piece& piece : pieces_of(rows_per_piece(local, piece_bytes), n_global, ranks.size())) {
    put_in_order(piece, ranks.all_gather_rows(rows_of_rank(piece, local, ranks.rank()), piece.counts), global);
  }
  return global;
}

std::vector<torch::Tensor> gather_rows(Communicator& ranks, const std::vector<torch::Tensor>& local,
                                       std::int64_t n_global, std::int64_t piece_bytes) {
  check_local_rows(ranks, local, n_global);
  if (ranks.size() == 1 || local.empty()) return local;
  std::vector<torch::Tensor> global;
  std::int64_t n_words = 0;
  for (const torch::Tensor& tensor : local) {
    global.push_back(torch::empty(sizes_with_rows(tensor, n_global), tensor.options()));
    n_words += words_per_row(tensor);
  }
  const torch::Tensor row = torch::empty({0, n_words}, torch::kInt32);  // for its size alone
  for (const Piece& piece : pieces_of(rows_per_piece(row, piece_bytes), n_global, ranks.size())) {
    std::vector<torch::Tensor> columns;
    for (const torch::Tensor& tensor : local) columns.push_back(rows_of_rank(piece, as_words(tensor), ranks.rank()));
    const torch::Tensor received = ranks.all_gather_rows(torch::cat(columns, 1), piece.counts);
    const torch::Tensor places = places_in_piece(piece, received.device());
    std::int64_t column = 0;
    for (const torch::Tensor& tensor : global) {
      const std::int64_t end = column + words_per_row(tensor);
      as_words(tensor).slice(0, piece.begin, piece.end).index_copy_(0, places, received.slice(1, column, end));
      column = end;
    }
  }
  return global;
}

void stream_rows_to_first(Communicator& ranks, const torch::Tensor& local, std::int64_t n_global,
                          const std::function<void(const torch::Tensor& rows)>& take, std::int64_t piece_bytes) {
  check_local_rows(ranks, {local}, n_global);
  if (ranks.size() == 1) return take(local.cpu());
  std::exception_ptr fault;
  const std::vector<std::int64_t> none(static_cast<std::size_t>(ranks.size()), 0);
  for (Piece piece : pieces_of(rows_per_piece(local, piece_bytes), n_global, ranks.size())) {
    const torch::Tensor rows = rows_of_rank(piece, local, ranks.rank());
    std::vector<std::int64_t> send = none;
    send[0] = rows.size(0);
    const torch::Tensor received = ranks.all_to_all_rows(rows, send, ranks.is_first() ? piece.counts : none);
    if (!ranks.is_first() || fault) continue;
    torch::Tensor ordered = torch::empty(sizes_with_rows(local, received.size(0)), local.options().device(torch::kCPU));
    piece.end -= std::exchange(piece.begin, 0);
    put_in_order(piece, received.cpu(), ordered);
    try {
      take(ordered);
    } catch (...) {
      fault = std::current_exception();  // the other ranks do not know
    }
  }
  if (fault) std::rethrow_exception(fault);
}

torch::Tensor gather_rows_on_first(Communicator& ranks, const torch::Tensor& local, std::int64_t n_global,
                                   std::int64_t piece_bytes) {
  if (ranks.size() == 1) {
    check_local_rows(ranks, {local}, n_global);
    return local.cpu();
  }
  torch::Tensor global;
  std::int64_t n_taken = 0;
  if (ranks.is_first() && local.defined() && local.dim() >= 1) {
    global = torch::empty(sizes_with_rows(local, n_global), local.options().device(torch::kCPU));
  }
  stream_rows_to_first(
      ranks, local, n_global,
      [&](const torch::Tensor& rows) {
        global.slice(0, n_taken, n_taken + rows.size(0)).copy_(rows);
        n_taken += rows.size(0);
      },
      piece_bytes);
  return global;
}

torch::Tensor gather_view_rows(Communicator& ranks, const torch::Tensor& drawn, const std::vector<int>& drawers) {
  std::vector<std::int64_t> counts(static_cast<std::size_t>(ranks.size()), 0), places;
  for (const int drawer : drawers) places.push_back(counts.at(static_cast<std::size_t>(drawer))++);
  const std::int64_t n_own = counts[static_cast<std::size_t>(ranks.rank())];
  B3DGS_CHECK(drawn.size(0) == n_own, drawn.size(0), " rows of ", n_own, " views that this rank draws");
  if (ranks.size() == 1) return drawn;
  const std::int64_t n_most = *std::max_element(counts.begin(), counts.end());  // parts of one size are faster
  torch::Tensor part = torch::zeros(sizes_with_rows(drawn, n_most), drawn.options());
  part.slice(0, 0, n_own).copy_(drawn);
  std::fill(counts.begin(), counts.end(), n_most);
  const torch::Tensor all = ranks.all_gather_rows(part, counts);
  for (std::size_t v = 0; v < drawers.size(); ++v) places[v] += drawers[v] * n_most;
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

std::int64_t rows_per_piece(const torch::Tensor& rows, std::int64_t piece_bytes) {
  const std::int64_t block_bytes = RowShards::kBlock * std::max<std::int64_t>(1, bytes_per_row(rows));
  return RowShards::kBlock * std::max<std::int64_t>(1, piece_bytes / block_bytes);
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

}  // namespace b3dgs
