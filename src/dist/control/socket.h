// TCP sockets for the control connections between ranks.
#pragma once

#include <chrono>
#include <optional>
#include <string>
#include <utility>

namespace b3dgs {

/// Owns a file descriptor.
class Socket {
 public:
  Socket() = default;
  explicit Socket(int fd) : fd_(fd) {}
  ~Socket();
  Socket(Socket&& other) noexcept : fd_(std::exchange(other.fd_, -1)) {}
  Socket& operator=(Socket&& other) noexcept {
    std::swap(fd_, other.fd_);
    return *this;
  }

  int fd() const { return fd_; }
  explicit operator bool() const { return fd_ >= 0; }

 private:
  int fd_ = -1;
};

/// Ends the poll() of another thread.
class Waker {
 public:
  Waker();
  int fd() const { return event_.fd(); }
  void wake() const;
  /// After poll(), which returns at once until then.
  void reset() const;

 private:
  Socket event_;
};

/// Listens at this address only. Port 0: a free one. @throws InputError if the address is unknown or the port occupied
Socket listen_at(const std::string& address, int port);

int port_of(const Socket& socket);

/// The numeric address of this machine that the socket is bound to.
std::string own_address_of(const Socket& socket);

/// The network interface of this machine that has this numeric address ("lo"); "" if none has.
std::string interface_with(const std::string& own_address);

/// nullopt if nobody answers, yet. @throws InputError if the address is unknown
std::optional<Socket> try_to_connect(const std::string& address, int port, std::chrono::milliseconds limit);

}  // namespace b3dgs
