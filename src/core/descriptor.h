// File descriptors that close themselves, and one that ends the poll() of another thread.
#pragma once

#include <sys/eventfd.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <utility>

#include "core/check.h"

namespace b3dgs {

/// Owns a file descriptor, or none (-1).
class Descriptor {
 public:
  Descriptor() = default;
  explicit Descriptor(int fd) : fd_(fd) {}
  ~Descriptor() { close(); }
  Descriptor(Descriptor&& other) noexcept : fd_(std::exchange(other.fd_, -1)) {}
  Descriptor& operator=(Descriptor&& other) noexcept {
    std::swap(fd_, other.fd_);
    return *this;
  }

  int fd() const { return fd_; }
  explicit operator bool() const { return fd_ >= 0; }
  void close() {
    if (fd_ >= 0) ::close(std::exchange(fd_, -1));
  }

 private:
  int fd_ = -1;
};

/// Ends the poll() of another thread.
class Waker {
 public:
  Waker() : event_(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)) {
    if (!event_) io_error("no event file from the system (", std::strerror(errno), ")");
  }
  int fd() const { return event_.fd(); }
  void wake() const { eventfd_write(event_.fd(), 1); }
  /// Call after poll(), which returns at once until then.
  void reset() const {
    eventfd_t count = 0;
    eventfd_read(event_.fd(), &count);
  }

 private:
  Descriptor event_;
};

}  // namespace b3dgs
