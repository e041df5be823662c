// Messages between RankHub and RankLink, time limits, and the error that reports another rank's failure.
#pragma once

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include "core/check.h"
#include "dist/control/socket.h"

namespace b3dgs {

struct RankLimits {
  std::chrono::milliseconds join{300000};    // from the start until all ranks have joined
  std::chrono::milliseconds silence{12000};  // a rank without a heartbeat for this time counts as lost
  // A rank is ended after this time if it learns that another one has failed but is stuck elsewhere, for example in a
  // GPU kernel that waits for that rank.
  std::chrono::milliseconds stuck{15000};

  /// Returns the time between heartbeats, which is also how long poll() waits.
  std::chrono::milliseconds beat() const { return std::min(silence / 6, std::chrono::milliseconds(500)); }
};

/// Reports that another rank has failed: "rank 2 of 4 stopped: out of memory".
class PeerError : public Error {
 public:
  /// Exit code of a process that ends for this reason. start_ranks() prefers the status of the rank that failed.
  static constexpr int kExitCode = 3;

  PeerError(int rank, int size, const std::string& cause)
      : Error(detail::one_line(detail::concat("rank ", rank, " of ", size, " stopped: ", cause))), rank_(rank) {}
  int rank() const { return rank_; }
  /// Does not repeat `more`, because the rank that failed may have sent the same text. One that was killed has not.
  [[noreturn]] void rethrow_with(const std::string& more) const override {
    const std::string text = what();
    throw PeerError(rank_, text.find(more) == std::string::npos ? text + more : text);
  }

 private:
  PeerError(int rank, const std::string& text) : Error(text), rank_(rank) {}

  int rank_;
};

enum class MessageKind : std::uint32_t {
  // from a rank to the hub
  kHello = 1,  // protocol, job, rank, size; answered when all ranks have joined
  kGather,     // label, then one part per rank or one for all; answered by the parts when every rank has sent one
  kSet,        // key, value
  kGet,        // key; answered by the value when it is set
  kAdd,        // key, number; answered by the sum
  kCheck,      // keys; answered by "1" if all are set
  kDelete,     // key; answered by "1" if it was set
  kFail,       // cause
  kBye,        // this rank has finished
  // from the hub to a rank
  kRefused = 11,  // reason; ranks of other versions know it by this number
  kReply,         // to the request with the same id
  kFailure,       // rank, cause
  // both ways
  kBeat,  // heartbeat
};

struct Message {
  MessageKind kind = MessageKind::kBeat;
  std::uint32_t id = 0;
  std::vector<std::string> parts;  // numbers as text
};

/// Uses the byte order of the machine, because all ranks run one program on one kind of machine.
std::string to_bytes(const Message& message);

inline constexpr std::uint32_t kHelloId = 0;             // id of the first request
inline constexpr std::size_t kMaxUntrustedBytes = 4096;  // per message
inline constexpr char kProtocol[] = "b3dgs ranks 5";

/// Messages over TCP, for the poll() loops of RankHub and RankLink. Nothing blocks. An error describes a fault of the
/// other end. Call close() then.
class Connection {
 public:
  /// @param is_trusted  the other end is known to be b3dgs. It may send long messages, must send heartbeats, and gets
  ///                    heartbeats. Otherwise it counts as lost after limits.silence.
  /// @param patience    extra time after limits.silence for the first message
  Connection(Socket socket, const RankLimits& limits, bool is_trusted, std::chrono::milliseconds patience = {});

  const Socket& socket() const { return socket_; }
  void trust() {
    is_trusted_ = true;
    last_heard_ = Clock::now();
  }
  void close() {
    socket_.close();
    unsent_.clear();
  }

  /// Calls handle() with each message that has arrived, as far as they can be read in a short time. @throws Error also
  /// if nothing has arrived for too long
  void receive(const std::function<void(const Message&)>& handle);

  void queue(const Message& message) {
    if (socket_) unsent_ += to_bytes(message);
  }
  bool has_unsent() const { return !unsent_.empty(); }
  /// Sends as much of the queue as the other end takes, and a heartbeat when it is due. @throws Error also if it has
  /// taken nothing for too long
  void flush();

 private:
  using Clock = std::chrono::steady_clock;

  Socket socket_;
  RankLimits limits_;
  bool is_trusted_;
  std::string received_, unsent_;
  Clock::time_point last_heard_, last_taken_ = Clock::now(), last_beat_ = last_taken_;
};

}  // namespace b3dgs
