// A rank's control connection to RankHub.
#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "dist/control/limits.h"

namespace b3dgs {

/// Every function but fail(), close() and the destructor throws a PeerError once another rank has failed. Safe to use
/// from several threads, except that all threads of a rank must call gather() and exchange()
/// in one order.
class RankLink {
 public:
  /// Joins, and waits until all ranks have. @throws InputError if this rank is refused, PeerError if another one failed
  RankLink(const std::string& address, int port, int rank, int size, const std::string& job, const RankLimits& limits);
  /// close()
  ~RankLink();
  RankLink(const RankLink&) = delete;
  RankLink& operator=(const RankLink&) = delete;

  int rank() const;
  int size() const;
  /// The numeric address of this machine that the other ranks can reach.
  std::string own_address() const;

  /// The records of all ranks, by rank. All ranks call this in one order, with the same `label`, which errors name.
  std::vector<std::string> gather(const std::string& label, const std::string& record);

  /// parts[r] goes to rank r, or the only part to all. Returns what came from each rank, by rank. All ranks call this
  /// in one order with gather(). The parts of a rank have less than 1 GiB together, as have those that it receives.
  std::vector<std::string> exchange(const std::string& label, const std::vector<std::string>& parts);

  // A table of keys and values that all ranks share, with the functions of c10d::Store.
  void set(const std::string& key, const std::string& value);
  /// Waits until the key is set. @throws Error after `limit`
  std::string get(const std::string& key, std::chrono::milliseconds limit);
  std::int64_t add(const std::string& key, std::int64_t number);
  bool check(const std::vector<std::string>& keys);
  bool remove(const std::string& key);
  std::string compare_set(const std::string& key, const std::string& expected, const std::string& desired);
  std::int64_t count();

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
  class Client;
  std::unique_ptr<Client> client_;
};

}  // namespace b3dgs
