// The server of the control connections: a thread of rank 0, to which every rank has one TCP connection.
#pragma once

#include <memory>
#include <string>

#include "dist/control/limits.h"
#include "dist/control/socket.h"

namespace b3dgs {

/// Lets ranks join, keeps a table of keys and values for them, gathers their records, and tells all of them when one
/// has failed: it said so, its connection closed without a farewell, or it was silent for too long.
class RankHub {
 public:
  /// @param listening  as listen_at() returns it
  /// @param job        ranks with another one are refused
  RankHub(Socket listening, int size, std::string job, const RankLimits& limits);
  /// Waits until all ranks have left; after a failure, at most limits.silence.
  ~RankHub();

 private:
  class Server;
  std::unique_ptr<Server> server_;
};

}  // namespace b3dgs
