// Time limits of the control connections, and the error that tells of another rank.
#pragma once

#include <chrono>
#include <string>

#include "core/check.h"

namespace b3dgs {

struct RankLimits {
  std::chrono::milliseconds join{300000};    // from the start until all ranks have joined
  std::chrono::milliseconds silence{12000};  // without a sign of life, a rank counts as lost
  // A rank that learns that another one has failed, and is stuck elsewhere, for example in a GPU kernel that waits for
  // that rank, is ended after this time.
  std::chrono::milliseconds stuck{15000};
};

/// Another rank has failed: "rank 2 of 4 stopped: out of memory".
class PeerError : public Error {
 public:
  /// Of a process that ends for this reason. start_ranks() prefers the status of the rank that failed.
  static constexpr int kExitCode = 3;

  PeerError(int rank, int size, const std::string& cause)
      : Error(detail::one_line(detail::concat("rank ", rank, " of ", size, " stopped: ", cause))), rank_(rank) {}
  /// The same failure, with more text.
  PeerError(const PeerError& failure, const std::string& more) : Error(failure.what() + more), rank_(failure.rank_) {}
  int rank() const { return rank_; }

 private:
  int rank_;
};

}  // namespace b3dgs
