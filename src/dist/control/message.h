// Time limits of the control connections, and the error that tells of another rank.
#pragma once

#include <chrono>
#include <cstdint>
#include <cstring>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "core/check.h"

namespace b3dgs {

struct RankLimits {
  std::chrono::milliseconds join{300000};    // from the start until all ranks have joined
  std::chrono::milliseconds silence{12000};  // without a sign of life, a rank counts as lost
  // A rank that learns that another one has failed, and is stuck elsewhere, for example in a GPU kernel that waits for
  // that rank, is ended after this time.
  std::chrono::milliseconds stuck{15000};
};

/// Another rank has failed: "rank 2 of 4 stopped: out of memory".
class PeerError : public Error {
 public:
  /// Of a process that ends for this reason. start_ranks() prefers the status of the rank that failed.
  static constexpr int kExitCode = 3;

  PeerError(int rank, int size, const std::string& cause)
      : Error(detail::one_line(detail::concat("rank ", rank, " of ", size, " stopped: ", cause))), rank_(rank) {}
  int rank() const { return rank_; }
  /// Without that text: the rank that failed says how to go on.
  [[noreturn]] void rethrow_with(const std::string& /*more*/) const override { throw PeerError(*this); }

 private:
  int rank_;
};

// Messages between RankHub and RankLink: a header, then numbers and byte strings in an agreed order. Numbers are in the
// byte order of the machine: all ranks run one program on one kind of machine.

enum class MessageKind : std::uint32_t {
  // from a rank to the hub
  kHello = 1,  // protocol, job, rank, size
  kGather,     // label, number of parts, parts; answered when every rank has sent one
  kSet,        // key, value
  kGet,        // key; answered when it is set
  kAdd,        // key, number; answered by the sum
  kCheck,      // keys
  kDelete,     // key
  kFail,       // cause
  kBye,        // this rank has finished
  // from the hub to a rank
  kWelcome,  // all ranks have joined
  kRefused,  // reason
  kReply,    // to the request of the same id
  kFailure,  // rank, cause
  // both ways
  kBeat,  // sign of life
};

struct Message {
  MessageKind kind = MessageKind::kBeat;
  std::uint32_t id = 0;
  std::string body;
};

class BodyWriter {
 public:
  BodyWriter& number(std::int64_t value) {
    body_.append(reinterpret_cast<const char*>(&value), sizeof value);
    return *this;
  }
  BodyWriter& bytes(std::string_view value) {
    number(static_cast<std::int64_t>(value.size()));
    body_.append(value);
    return *this;
  }
  std::string take() { return std::move(body_); }

 private:
  std::string body_;
};

class BodyReader {
 public:
  explicit BodyReader(std::string_view body) : rest_(body) {}

  /// @throws Error if the body is too short
  std::int64_t number() {
    std::int64_t value = 0;
    std::memcpy(&value, take(sizeof value).data(), sizeof value);
    return value;
  }
  std::string bytes() {
    const std::int64_t size = number();
    if (size < 0) throw Error("a damaged message");
    return std::string(take(static_cast<std::uint64_t>(size)));
  }

 private:
  std::string_view take(std::uint64_t size) {
    if (size > rest_.size()) throw Error("a damaged message");
    const std::string_view taken = rest_.substr(0, size);
    rest_.remove_prefix(size);
    return taken;
  }
  std::string_view rest_;
};

inline std::string to_bytes(const Message& message) {
  const std::uint32_t header[3] = {static_cast<std::uint32_t>(message.body.size()),
                                   static_cast<std::uint32_t>(message.kind), message.id};
  return std::string(reinterpret_cast<const char*>(header), sizeof header) + message.body;
}

/// Assembles messages from the bytes of a connection.
class MessageStream {
 public:
  void feed(const char* data, std::size_t size) { bytes_.append(data, size); }

  /// The next complete message. @throws Error if it is longer than `limit` bytes
  std::optional<Message> next(std::size_t limit) {
    std::uint32_t header[3];
    if (bytes_.size() - begin_ < sizeof header) return std::nullopt;
    std::memcpy(header, bytes_.data() + begin_, sizeof header);
    if (header[0] > limit) throw Error("a message that is too long");
    if (bytes_.size() - begin_ - sizeof header < header[0]) return std::nullopt;
    Message message{static_cast<MessageKind>(header[1]), header[2], bytes_.substr(begin_ + sizeof header, header[0])};
    begin_ += sizeof header + header[0];
    if (begin_ == bytes_.size() || begin_ > 65536) {
      bytes_.erase(0, begin_);
      begin_ = 0;
    }
    return message;
  }

 private:
  std::string bytes_;
  std::size_t begin_ = 0;
};

inline constexpr std::size_t kMaxMessage = std::size_t{1} << 30;
inline constexpr char kProtocol[] = "b3dgs ranks 3";

}  // namespace b3dgs
