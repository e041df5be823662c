#include "dist/control/message.h"

#include <netinet/in.h>
#include <netinet/tcp.h>
#include <sys/socket.h>

#include <array>
#include <cerrno>
#include <cstring>
#include <optional>
#include <string_view>

namespace b3dgs {
namespace {

constexpr std::size_t kMaxBytes = std::size_t{1} << 30;  // per message
constexpr int kMaxReads = 16;                            // an endless sender must not starve the others
constexpr char kVanished[] = "its process ended without saying why (killed?), or the network to it failed";

struct Header {
  std::uint32_t bytes;  // bytes that follow: each part after its size
  MessageKind kind;
  std::uint32_t id;
};

template <class Value>
Value value_at(std::string_view bytes) {
  Value value;
  if (bytes.size() < sizeof value) throw Error("a damaged message");
  std::memcpy(&value, bytes.data(), sizeof value);
  return value;
}

/// Removes the first message from `bytes` and returns it, or nullopt if it is not complete.
std::optional<Message> next_message(std::string_view& bytes, std::size_t max_bytes) {
  if (bytes.size() < sizeof(Header)) return std::nullopt;
  const auto header = value_at<Header>(bytes);
  if (header.bytes > max_bytes) throw Error("a message that is too long");
  if (bytes.size() - sizeof(Header) < header.bytes) return std::nullopt;
  Message message{header.kind, header.id, {}};
  std::string_view body = bytes.substr(sizeof(Header), header.bytes);
  bytes.remove_prefix(sizeof(Header) + header.bytes);
  while (!body.empty()) {
    const auto size = value_at<std::uint64_t>(body);
    body.remove_prefix(sizeof size);
    if (size > body.size()) throw Error("a damaged message");
    message.parts.emplace_back(body.substr(0, size));
    body.remove_prefix(size);
  }
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

Connection::Connection(Socket socket, const RankLimits& limits, bool is_trusted, std::chrono::milliseconds patience)
    : socket_(std::move(socket)), limits_(limits), is_trusted_(is_trusted), last_heard_(Clock::now() + patience) {
  const int yes = 1;
  setsockopt(socket_.fd(), IPPROTO_TCP, TCP_NODELAY, &yes, sizeof yes);
}

void Connection::receive(const std::function<void(const Message&)>& handle) {
  std::array<char, 65536> buffer;
  for (int i = 0; i < kMaxReads; ++i) {
    const ssize_t n = recv(socket_.fd(), buffer.data(), buffer.size(), MSG_DONTWAIT);
    if (n < 0 && would_wait()) break;
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) throw Error(kVanished);
    if (is_trusted_) last_heard_ = Clock::now();
    received_.append(buffer.data(), static_cast<std::size_t>(n));
    std::string_view rest = received_;
    while (const auto message = next_message(rest, is_trusted_ ? kMaxBytes : kMaxUntrustedBytes)) {
      if (message->kind != MessageKind::kBeat) handle(*message);
    }
    received_.erase(0, received_.size() - rest.size());
  }
  if (Clock::now() - last_heard_ > limits_.silence) {
    throw Error(detail::concat("no sign of life for ", limits_.silence.count() / 1000, " s"));
  }
}

void Connection::flush() {
  const auto now = Clock::now();
  if (is_trusted_ && now - last_beat_ >= limits_.beat()) {
    queue({});
    last_beat_ = now;
  }
  std::size_t sent = 0;
  while (sent < unsent_.size()) {
    const ssize_t n = send(socket_.fd(), unsent_.data() + sent, unsent_.size() - sent, MSG_NOSIGNAL | MSG_DONTWAIT);
    if (n < 0 && would_wait()) break;
    if (n < 0 && errno != EINTR) throw Error(kVanished);
    if (n > 0) sent += static_cast<std::size_t>(n);
  }
  unsent_.erase(0, sent);
  if (sent > 0 || unsent_.empty()) last_taken_ = now;
  if (now - last_taken_ > limits_.silence) {
    throw Error(detail::concat("it took nothing of a message for ", limits_.silence.count() / 1000, " s"));
  }
}

}  // namespace b3dgs
