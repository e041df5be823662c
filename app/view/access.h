// Access to the server, which needs a random token and an address that the name of another site cannot imitate.
#pragma once

#include <chrono>
#include <map>
#include <mutex>
#include <set>
#include <string>

namespace b3dgs {

/// Returns 128 random bits from the system, as 32 hexadecimal digits. @throws IoError
std::string make_token();

/// Compares strings. For equal lengths, the duration does not reveal where they differ.
bool equal_in_constant_time(const std::string& a, const std::string& b);

/// Returns whether the Host header of a request names this server by an address: 127.0.0.1, [::1], localhost, or, if
/// the server listens on another address, any numeric one. A name is not accepted, because another site may have
/// pointed it here (DNS rebinding). Any port is accepted, because a tunnel changes it.
bool is_own_host(const std::string& host, const std::string& listens_on);

/// Returns whether the Origin header of a request, if it has one, is that of the page itself.
bool is_own_origin(const std::string& origin, const std::string& host);

/// Returns whether an address is reachable only from this machine: 127.0.0.0/8, ::1, localhost.
bool is_loopback(const std::string& address);

/// Limits the number of browsers at the same time, and renders one picture at a time for each.
class ClientLimit {
 public:
  using Clock = std::chrono::steady_clock;
  explicit ClientLimit(std::size_t most) : most_(most) {}

  /// Notes a request of a client. Returns false if there are too many others. A client that has not asked for anything
  /// for five seconds has left, even if it still waits for a picture: a page that was closed does not withdraw one.
  bool admit(const std::string& client, Clock::time_point now);
  /// Returns false if the client has a picture in work already, or too many others have one.
  bool begin_picture(const std::string& client);
  void end_picture(const std::string& client);
  /// Registers whether a client waits for the end of the training.
  void set_waiting(const std::string& client, bool is_waiting);
  /// Returns whether a client waits that has sent a request since then.
  bool has_waiting(Clock::time_point since);

 private:
  const std::size_t most_;
  std::mutex mutex_;
  std::map<std::string, Clock::time_point> seen_;
  std::set<std::string> in_work_, waiting_;
};

}  // namespace b3dgs
