#include "dist/control/socket.h"

#include <ifaddrs.h>
#include <netdb.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <sys/time.h>

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

/// Returns the numeric address and the port, or "" and 0 if it is not an IP address.
std::pair<std::string, int> numbers_of(const sockaddr* address) {
  const bool is_v4 = address->sa_family == AF_INET;
  if (!is_v4 && address->sa_family != AF_INET6) return {"", 0};
  const auto length = static_cast<socklen_t>(is_v4 ? sizeof(sockaddr_in) : sizeof(sockaddr_in6));
  std::array<char, NI_MAXHOST> host{};
  std::array<char, NI_MAXSERV> service{"0"};
  getnameinfo(address, length, host.data(), host.size(), service.data(), service.size(),
              NI_NUMERICHOST | NI_NUMERICSERV);
  return {host.data(), std::stoi(service.data())};
}

/// Returns the address and port that the socket is bound to.
std::pair<std::string, int> own_numbers_of(const Socket& socket) {
  sockaddr_storage own{};
  socklen_t length = sizeof own;
  if (getsockname(socket.fd(), reinterpret_cast<sockaddr*>(&own), &length) != 0) {
    io_error("cannot read the address of a socket: ", std::strerror(errno));
  }
  return numbers_of(reinterpret_cast<sockaddr*>(&own));
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
  return own_numbers_of(socket).second;
}

std::string own_address_of(const Socket& socket) {
  return own_numbers_of(socket).first;
}

std::string interface_with(const std::string& own_address) {
  ifaddrs* all = nullptr;
  if (getifaddrs(&all) != 0) return "";
  const std::unique_ptr<ifaddrs, decltype(&freeifaddrs)> owner(all, &freeifaddrs);
  for (const ifaddrs* row = all; row != nullptr; row = row->ifa_next) {
    if (row->ifa_addr != nullptr && numbers_of(row->ifa_addr).first == own_address) return row->ifa_name;
  }
  return "";
}

std::optional<Socket> try_to_connect(const std::string& address, int port, std::chrono::milliseconds limit) {
  const Addresses addresses = look_up(address, port);
  for (const addrinfo* row = addresses.get(); row != nullptr; row = row->ai_next) {
    Socket socket(::socket(row->ai_family, row->ai_socktype | SOCK_CLOEXEC, row->ai_protocol));
    const timeval time{limit.count() / 1000, limit.count() % 1000 * 1000};  // also the limit of connect()
    if (socket && setsockopt(socket.fd(), SOL_SOCKET, SO_SNDTIMEO, &time, sizeof time) == 0 &&
        connect(socket.fd(), row->ai_addr, row->ai_addrlen) == 0) {
      return socket;
    }
  }
  return std::nullopt;
}

}  // namespace b3dgs
