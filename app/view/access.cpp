#include "app/view/access.h"

#include <arpa/inet.h>
#include <sys/random.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>

#include "core/check.h"

namespace b3dgs {
namespace {

constexpr std::chrono::seconds kGone{5};

/// Returns the name without the port: "[::1]:8080" -> "[::1]".
std::string without_port(const std::string& host) {
  if (!host.empty() && host[0] == '[') return host.substr(0, host.find(']') + 1);
  return host.substr(0, host.find(':'));
}

bool is_numeric(const std::string& name) {
  std::array<unsigned char, sizeof(in6_addr)> bytes{};
  if (inet_pton(AF_INET, name.c_str(), bytes.data()) == 1) return true;
  const bool has_brackets = name.size() > 2 && name.front() == '[' && name.back() == ']';
  return has_brackets && inet_pton(AF_INET6, name.substr(1, name.size() - 2).c_str(), bytes.data()) == 1;
}

}  // namespace

std::string make_token() {
  std::array<unsigned char, 16> bytes{};
  if (getrandom(bytes.data(), bytes.size(), 0) != static_cast<ssize_t>(bytes.size())) {
    io_error("no random numbers from the system (", std::strerror(errno), ")");
  }
  constexpr char kDigits[] = "0123456789abcdef";
  std::string token;
  for (const unsigned char byte : bytes) {
    token += kDigits[byte >> 4];
    token += kDigits[byte & 15];
  }
  return token;
}

bool equal_in_constant_time(const std::string& a, const std::string& b) {
  if (a.size() != b.size()) return false;
  unsigned char difference = 0;
  for (std::size_t i = 0; i < a.size(); ++i) difference |= static_cast<unsigned char>(a[i] ^ b[i]);
  return difference == 0;
}

bool is_loopback(const std::string& address) {
  return address == "localhost" || address == "::1" || address == "[::1]" ||
         (address.compare(0, 4, "127.") == 0 && is_numeric(address));
}

bool is_own_host(const std::string& host, const std::string& listens_on) {
  const std::string name = without_port(host);
  return is_loopback(name) || (!is_loopback(listens_on) && is_numeric(name));
}

bool is_own_origin(const std::string& origin, const std::string& host) {
  return origin.empty() || origin == "http://" + host;
}

bool ClientLimit::admit(const std::string& client, Clock::time_point now) {
  const std::lock_guard<std::mutex> lock(mutex_);
  for (auto it = seen_.begin(); it != seen_.end();) {
    const bool has_left = now - it->second > kGone;
    if (has_left) waiting_.erase(it->first);
    it = has_left ? seen_.erase(it) : std::next(it);
  }
  if (seen_.count(client) == 0 && seen_.size() >= most_) return false;
  seen_[client] = now;
  return true;
}

bool ClientLimit::begin_picture(const std::string& client) {
  const std::lock_guard<std::mutex> lock(mutex_);
  return in_work_.size() < most_ && in_work_.insert(client).second;
}

void ClientLimit::end_picture(const std::string& client) {
  const std::lock_guard<std::mutex> lock(mutex_);
  in_work_.erase(client);
}

void ClientLimit::set_waiting(const std::string& client, bool is_waiting) {
  const std::lock_guard<std::mutex> lock(mutex_);
  waiting_.erase(client);
  if (is_waiting) waiting_.insert(client);
}

bool ClientLimit::has_waiting(Clock::time_point since) {
  const std::lock_guard<std::mutex> lock(mutex_);
  return std::any_of(waiting_.begin(), waiting_.end(),
                     [&](const std::string& client) { return seen_[client] >= since; });
}

}  // namespace b3dgs
