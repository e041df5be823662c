#include "dist/control/message.h"

#include <sys/socket.h>

#include <array>
#include <cerrno>
#include <cstring>
#include <optional>
#include <string_view>

namespace b3dgs {
namespace {

constexpr int kMaxReads = 16;  // nobody who sends without end may keep the caller from others
constexpr char kVanished[] = "its process ended without saying why (killed?), or the network to it failed";

struct Header {
  std::uint32_t bytes;  // that follow: each part after its size
  MessageKind kind;
  std::uint32_t id;
};

/// Removes the first bytes of `from` and returns them.
std::string_view take(std::string_view& from, std::size_t size) {
  if (size > from.size()) throw Error("a damaged message");
  const std::string_view taken = from.substr(0, size);
  from.remove_prefix(size);
  return taken;
}

template <class Value>
Value take_value(std::string_view& from) {
  Value value;
  std::memcpy(&value, take(from, sizeof value).data(), sizeof value);
  return value;
}

/// The first message, removed from `bytes`; nothing if it is not complete.
std::optional<Message> next_message(std::string_view& bytes, std::size_t max_message) {
  if (bytes.size() < sizeof(Header)) return std::nullopt;
  std::string_view rest = bytes;
  const auto header = take_value<Header>(rest);
  if (header.bytes > max_message) throw Error("a message that is too long");
  if (rest.size() < header.bytes) return std::nullopt;
  std::string_view body = take(rest, header.bytes);
  Message message{header.kind, header.id, {}};
  while (!body.empty()) message.parts.emplace_back(take(body, take_value<std::uint64_t>(body)));
  bytes = rest;
  return message;
}

bool would_wait() {
  return errno == EAGAIN || errno == EWOULDBLOCK;
}

}  // namespace

std::string to_bytes(const Message& message) {
  std::string body;
  for (const std::string& part : message.parts) {
    const std::uint64_t size = part.size();
    body.append(reinterpret_cast<const char*>(&size), sizeof size).append(part);
  }
  const Header header{static_cast<std::uint32_t>(body.size()), message.kind, message.id};
  return std::string(reinterpret_cast<const char*>(&header), sizeof header) + body;
}

bool Connection::receive(const std::function<void(const Message&)>& handle) {
  std::array<char, 65536> buffer;
  bool has_come = false;
  for (int i = 0; i < kMaxReads; ++i) {
    const ssize_t n = recv(socket_.fd(), buffer.data(), buffer.size(), MSG_DONTWAIT);
    if (n < 0 && would_wait()) break;
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) throw Error(kVanished);
    has_come = true;
    received_.append(buffer.data(), static_cast<std::size_t>(n));
    std::string_view rest = received_;
    while (const std::optional<Message> message = next_message(rest, max_message_)) handle(*message);
    received_.erase(0, received_.size() - rest.size());
  }
  return has_come;
}

bool Connection::flush() {
  std::size_t sent = 0;
  while (sent < unsent_.size()) {
    const ssize_t n = send(socket_.fd(), unsent_.data() + sent, unsent_.size() - sent, MSG_NOSIGNAL | MSG_DONTWAIT);
    if (n < 0 && would_wait()) break;
    if (n < 0 && errno != EINTR) throw Error(kVanished);
    if (n > 0) sent += static_cast<std::size_t>(n);
  }
  unsent_.erase(0, sent);
  return sent > 0;
}

}  // namespace b3dgs
