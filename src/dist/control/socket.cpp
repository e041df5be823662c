#include "dist/control/socket.h"

#include <ifaddrs.h>
#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/socket.h>

#include <array>
#include <cerrno>
#include <cstring>
#include <memory>

#include "core/check.h"

namespace b3dgs {
namespace {

using Addresses = std::unique_ptr<addrinfo, decltype(&freeaddrinfo)>;

Addresses look_up(const std::string& address, int port) {
  addrinfo hints{};
  hints.ai_family = AF_UNSPEC;
  hints.ai_socktype = SOCK_STREAM;
  addrinfo* found = nullptr;
  const int error = getaddrinfo(address.c_str(), std::to_string(port).c_str(), &hints, &found);
  if (error != 0) input_error("address of rank 0 not found: ", address, " (", gai_strerror(error), ")");
  return {found, &freeaddrinfo};
}

/// The numeric address and the port that the socket is bound to.
std::pair<std::string, int> own_end(const Socket& socket) {
  sockaddr_storage own{};
  socklen_t length = sizeof own;
  std::array<char, NI_MAXHOST> host{};
  std::array<char, NI_MAXSERV> service{};
  if (getsockname(socket.fd(), reinterpret_cast<sockaddr*>(&own), &length) != 0 ||
      getnameinfo(reinterpret_cast<sockaddr*>(&own), length, host.data(), host.size(), service.data(), service.size(),
                  NI_NUMERICHOST | NI_NUMERICSERV) != 0) {
    io_error("cannot read the address of a socket: ", std::strerror(errno));
  }
  return {host.data(), std::stoi(service.data())};
}

}  // namespace

Socket listen_at(const std::string& address, int port) {
  const Addresses addresses = look_up(address, port);
  int error = 0;
  for (const addrinfo* row = addresses.get(); row != nullptr; row = row->ai_next) {
    Socket socket(::socket(row->ai_family, row->ai_socktype | SOCK_CLOEXEC, row->ai_protocol));
    const int yes = 1;
    if (socket) setsockopt(socket.fd(), SOL_SOCKET, SO_REUSEADDR, &yes, sizeof yes);
    if (socket && bind(socket.fd(), row->ai_addr, row->ai_addrlen) == 0 && listen(socket.fd(), SOMAXCONN) == 0) {
      return socket;
    }
    error = errno;
  }
  if (error == EADDRINUSE) {
    input_error("port ", port, " of ", address,
                " is occupied; set MASTER_PORT to a free port (torchrun: --master-port)");
  }
  input_error("cannot listen at ", address, " port ", port, ": ", std::strerror(error),
              " (rank 0 must run on the machine that has the address MASTER_ADDR)");
}

int port_of(const Socket& socket) {
  return own_end(socket).second;
}

std::string own_address_of(const Socket& socket) {
  return own_end(socket).first;
}

std::string interface_with(const std::string& own_address) {
  ifaddrs* all = nullptr;
  if (getifaddrs(&all) != 0) return "";
  const std::unique_ptr<ifaddrs, decltype(&freeifaddrs)> owner(all, &freeifaddrs);
  for (const ifaddrs* row = all; row != nullptr; row = row->ifa_next) {
    if (row->ifa_addr == nullptr) continue;
    const bool is_v4 = row->ifa_addr->sa_family == AF_INET;
    if (!is_v4 && row->ifa_addr->sa_family != AF_INET6) continue;
    std::array<char, NI_MAXHOST> host{};
    const auto length = static_cast<socklen_t>(is_v4 ? sizeof(sockaddr_in) : sizeof(sockaddr_in6));
    if (getnameinfo(row->ifa_addr, length, host.data(), host.size(), nullptr, 0, NI_NUMERICHOST) == 0 &&
        own_address == host.data()) {
      return row->ifa_name;
    }
  }
  return "";
}

std::optional<Socket> try_to_connect(const std::string& address, int port, std::chrono::milliseconds limit) {
  const Addresses addresses = look_up(address, port);
  for (const addrinfo* row = addresses.get(); row != nullptr; row = row->ai_next) {
    Socket socket(::socket(row->ai_family, row->ai_socktype | SOCK_CLOEXEC | SOCK_NONBLOCK, row->ai_protocol));
    if (!socket) continue;
    if (connect(socket.fd(), row->ai_addr, row->ai_addrlen) != 0) {
      if (errno != EINPROGRESS) continue;
      pollfd waiting{socket.fd(), POLLOUT, 0};
      int error = 0;
      socklen_t length = sizeof error;
      if (poll(&waiting, 1, static_cast<int>(limit.count())) != 1 ||
          getsockopt(socket.fd(), SOL_SOCKET, SO_ERROR, &error, &length) != 0 || error != 0) {
        continue;
      }
    }
    const int yes = 1;
    setsockopt(socket.fd(), IPPROTO_TCP, TCP_NODELAY, &yes, sizeof yes);
    return socket;
  }
  return std::nullopt;
}

}  // namespace b3dgs
