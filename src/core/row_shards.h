// Which rows of a table each of several processes (ranks) holds.
#pragma once

#include <cstdint>

#include "core/vec.h"

namespace b3dgs {

/// Rows are dealt to the ranks in blocks of kBlock: global row i belongs to block i / kBlock, and block b to rank
/// b % size. A rank keeps its blocks in ascending order, so that its rows ascend too. Rows added at the end move no
/// other row.
struct RowShards {
  static constexpr std::int64_t kBlock = 32;

  int rank = 0, size = 1;

  /// How many of the global rows this rank holds.
  B3DGS_HD std::int64_t n_local(std::int64_t n_global) const {
    const std::int64_t n_full = n_global / kBlock, n_extra = n_full % size;
    return (n_full / size + (rank < n_extra ? 1 : 0)) * kBlock + (rank == n_extra ? n_global % kBlock : 0);
  }

  B3DGS_HD std::int64_t global_row(std::int64_t local) const {
    return (local / kBlock * size + rank) * kBlock + local % kBlock;
  }

  B3DGS_HD int owner(std::int64_t global) const { return static_cast<int>(global / kBlock % size); }

  /// The local row, on its owner.
  B3DGS_HD std::int64_t local_row(std::int64_t global) const {
    return global / kBlock / size * kBlock + global % kBlock;
  }
};

}  // namespace b3dgs
