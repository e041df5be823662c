// The control connections between ranks: RankLink in each rank, and RankHub, their server, a thread of rank 0.
#pragma once

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <exception>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "dist/control/message.h"
#include "dist/control/socket.h"

namespace b3dgs {

/// Every function except fail(), close() and the destructor throws a PeerError once another rank has failed. Safe to
/// use from several threads, except that only one may call exchange() at a time.
class RankLink {
 public:
  /// Joins, and waits until all ranks have. @throws InputError if this rank is refused, PeerError if another one failed
  RankLink(const std::string& address, int port, int rank, int size, const std::string& job, const RankLimits& limits);
  /// Calls close().
  ~RankLink();
  RankLink(const RankLink&) = delete;
  RankLink& operator=(const RankLink&) = delete;

  int rank() const { return rank_; }
  int size() const { return size_; }
  /// Returns the numeric address of this machine that the other ranks can reach.
  const std::string& own_address() const { return own_address_; }

  /// Sends a request and waits for its answer. @throws InputError if there is none after `limit`
  std::vector<std::string> request(MessageKind kind, std::vector<std::string> parts,
                                   std::chrono::milliseconds limit = std::chrono::hours(24 * 365));

  /// Sends parts[r] to rank r, or the only part to all. Returns the part from each rank, by rank. All ranks must call
  /// this in the same order with the same `label`, which errors name. The parts that a rank sends, and those that it
  /// receives, must have less than 1 GiB in total.
  std::vector<std::string> exchange(const std::string& label, std::vector<std::string> parts);

  void throw_if_failed();
  /// Waits until it is known that another rank has failed. Returns false after `limit`.
  bool wait_for_failure(std::chrono::milliseconds limit);
  /// Calls `call` once when another rank has failed: in a new thread, or here if that is already known.
  void on_failure(std::function<void()> call);

  /// Tells all other ranks that this one stops, and waits until that is sent, at most a few seconds. The first cause is
  /// kept. Only its first line is sent.
  void fail(const std::string& cause) noexcept { leave(MessageKind::kFail, cause); }
  /// Tells the others that this rank has finished. Does nothing in a second call and after fail().
  void close() noexcept { leave(MessageKind::kBye, ""); }

 private:
  void leave(MessageKind kind, const std::string& cause) noexcept;
  void run();
  void stop();
  // The following require that mutex_ is locked.
  void throw_if_failed_locked();
  void handle(const Message& message);
  void note_failure(std::exception_ptr failure);

  int rank_, size_;
  RankLimits limits_;
  std::string place_;  // address of rank 0, for messages
  std::string own_address_;
  Waker wake_;

  std::mutex mutex_;  // guards the following members
  std::condition_variable changed_;
  Connection connection_;  // only the thread receives
  std::uint32_t next_id_ = kHelloId;
  std::map<std::uint32_t, std::vector<std::string>> replies_;  // by request id
  std::exception_ptr failure_;                                 // a PeerError, or an InputError if refused
  std::function<void()> on_failure_;
  /// When the process is ended, unless this rank's own thread learns of the failure.
  std::optional<std::chrono::steady_clock::time_point> stuck_at_;
  bool has_left_ = false, is_stopping_ = false;
  std::thread thread_;
};

/// Lets ranks join, keeps a key-value table for them, gathers their messages, and tells all of them when one has
/// failed: it reported this, its connection closed without a message, or it was silent for too long.
class RankHub {
 public:
  /// Waits until all ranks have left. After a failure, waits at most limits.silence.
  virtual ~RankHub() = default;
};
/// @param listening  result of listen_at()
/// @param job        ranks with a different one are refused
std::unique_ptr<RankHub> start_rank_hub(Socket listening, int size, std::string job, const RankLimits& limits);

}  // namespace b3dgs
