// The control connections between ranks: RankLink of each rank, and RankHub, their server, a thread of rank 0.
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

/// Every function but fail(), close() and the destructor throws a PeerError once another rank has failed. Safe to use
/// from several threads, except that only one may call exchange() at a time.
class RankLink {
 public:
  /// Joins, and waits until all ranks have. @throws InputError if this rank is refused, PeerError if another one failed
  RankLink(const std::string& address, int port, int rank, int size, const std::string& job, const RankLimits& limits);
  /// close()
  ~RankLink();
  RankLink(const RankLink&) = delete;
  RankLink& operator=(const RankLink&) = delete;

  int rank() const { return rank_; }
  int size() const { return size_; }
  /// The numeric address of this machine that the other ranks can reach.
  const std::string& own_address() const { return own_address_; }

  /// Sends a request and waits for its answer. @throws InputError if there is none after `limit`
  std::vector<std::string> request(MessageKind kind, std::vector<std::string> parts,
                                   std::chrono::milliseconds limit = std::chrono::hours(24 * 365));

  /// parts[r] goes to rank r, or the only part to all. Returns what came from each rank, by rank. All ranks call this
  /// in one order, with the same `label`, which errors name. The parts of a rank have less than 1 GiB together, as have
  /// those that it receives.
  std::vector<std::string> exchange(const std::string& label, std::vector<std::string> parts);

  void throw_if_failed();
  /// Waits until it is known that another rank has failed. False after `limit`.
  bool wait_for_failure(std::chrono::milliseconds limit);
  /// `call` is called once when another rank has failed, in a thread of its own, or here if that is known already.
  void on_failure(std::function<void()> call);

  /// Tells all other ranks that this one stops, and waits until that is sent, at most a few seconds. The first cause
  /// is kept. Only its first line is sent.
  void fail(const std::string& cause) noexcept { leave(MessageKind::kFail, cause); }
  /// This rank has finished. Called twice, and after fail(), it does nothing.
  void close() noexcept { leave(MessageKind::kBye, ""); }

 private:
  void leave(MessageKind kind, const std::string& cause) noexcept;
  void run();
  void stop();
  // With mutex_ locked.
  void throw_if_failed_locked();
  void handle(const Message& message);
  void note_failure(std::exception_ptr failure);

  int rank_, size_;
  RankLimits limits_;
  std::string place_;  // of rank 0, for messages
  std::string own_address_;
  Waker wake_;

  std::mutex mutex_;  // guards what follows
  std::condition_variable changed_;
  Connection connection_;  // only the thread receives
  std::uint32_t next_id_ = kHelloId;
  std::map<std::uint32_t, std::vector<std::string>> replies_;  // by id of the request
  std::exception_ptr failure_;                                 // a PeerError, or an InputError: refused
  std::function<void()> on_failure_;
  /// When the process is ended, unless this rank's own thread learns of the failure.
  std::optional<std::chrono::steady_clock::time_point> stuck_at_;
  bool has_left_ = false, is_stopping_ = false;
  std::thread thread_;
};

/// Lets ranks join, keeps a table of keys and values for them, gathers their records, and tells all of them when one
/// has failed: it said so, its connection closed without a farewell, or it was silent for too long.
class RankHub {
 public:
  /// Waits until all ranks have left; after a failure, at most limits.silence.
  virtual ~RankHub() = default;
};
/// @param listening  as listen_at() returns it
/// @param job        ranks with another one are refused
std::unique_ptr<RankHub> start_rank_hub(Socket listening, int size, std::string job, const RankLimits& limits);

}  // namespace b3dgs
