// A rank's control connection to RankHub.
#pragma once

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
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
/// from several threads, except that all threads of a rank must call exchange() in one order.
// Members stand in the order of who uses them.
class RankLink {  // NOLINT(clang-analyzer-optin.performance.Padding)
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

  /// parts[r] goes to rank r, or the only part to all. Returns what came from each rank, by rank. All ranks call this
  /// in one order, with the same `label`, which errors name. The parts of a rank have less than 1 GiB together, as have
  /// those that it receives.
  std::vector<std::string> exchange(const std::string& label, std::vector<std::string> parts);

  // A table of keys and values that all ranks share, with the functions of c10d::Store.
  void set(const std::string& key, const std::string& value);
  /// Waits until the key is set. @throws Error after `limit`
  std::string get(const std::string& key, std::chrono::milliseconds limit);
  std::int64_t add(const std::string& key, std::int64_t number);
  bool check(const std::vector<std::string>& keys);
  bool remove(const std::string& key);

  void throw_if_failed();
  /// Waits until it is known that another rank has failed. False after `limit`.
  bool wait_for_failure(std::chrono::milliseconds limit);
  /// `call` is called once when another rank has failed, in a thread of its own, or here if that is known already.
  void on_failure(std::function<void()> call);

  /// Tells all other ranks that this one stops, and waits until that is sent, at most a few seconds. The first cause
  /// is kept. Only its first line is sent.
  void fail(const std::string& cause) noexcept;

  /// This rank has finished. Called twice, and after fail(), it does nothing.
  void close() noexcept;

 private:
  /// Sends a request and waits for its answer.
  std::vector<std::string> request(MessageKind kind, std::vector<std::string> parts,
                                   std::optional<std::chrono::milliseconds> limit = {});
  /// Sends kFail or kBye, once.
  void leave(MessageKind kind, const std::string& cause) noexcept;
  void throw_if_failed_locked();
  /// Returns at once; the thread sends what the hub does not take now.
  void send(const Message& message);
  void run();
  void wait_for_events(std::chrono::milliseconds limit);
  void exchange_bytes();
  void handle(const Message& message);
  void note_failure(int rank, const std::string& cause);
  [[noreturn]] void end_process() const;
  void stop();

  int rank_, size_;
  RankLimits limits_;
  std::string own_address_;
  Waker wake_;
  Connection connection_;  // only the thread receives

  std::mutex send_mutex_;  // guards what is unsent
  std::chrono::steady_clock::time_point last_sent_;

  // of the thread
  std::chrono::steady_clock::time_point last_heard_;
  bool has_lost_hub_ = false;

  std::mutex mutex_;  // guards what follows
  std::condition_variable changed_;
  std::optional<std::string> refusal_;
  std::optional<PeerError> failure_;
  bool is_acknowledged_ = false;  // this rank's own thread knows of the failure, or has finished
  bool is_closed_ = false;
  std::function<void()> on_failure_;
  std::uint32_t next_id_ = kHelloId + 1;
  std::map<std::uint32_t, std::vector<std::string>> replies_;  // by id of the request

  std::atomic<bool> is_stopping_{false};
  std::thread thread_;
};

// The server of the control connections: a thread of rank 0, to which every rank has one TCP connection.

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
