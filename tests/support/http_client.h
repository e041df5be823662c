// HTTP over a socket to a server on this machine, with well-formed requests and with raw bytes. Waits at most half a
// minute for the server.
#pragma once

#include <netinet/in.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <unistd.h>

#include <algorithm>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <utility>

namespace b3dgs::test {

using HttpHeaders = std::multimap<std::string, std::string>;

struct HttpAnswer {
  int status = 0;
  HttpHeaders headers;  // names as they are sent
  std::string body;

  std::string header(const std::string& name) const {
    const auto found = headers.find(name);
    return found == headers.end() ? std::string() : found->second;
  }
};

/// One connection.
class RawClient {
 public:
  explicit RawClient(int port) : socket_(socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(static_cast<std::uint16_t>(port));
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    const timeval patience{30, 0};
    setsockopt(socket_, SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience);
    setsockopt(socket_, SOL_SOCKET, SO_SNDTIMEO, &patience, sizeof patience);
    is_connected_ = connect(socket_, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0;
  }
  RawClient(RawClient&& other) noexcept
      : socket_(std::exchange(other.socket_, -1)), is_connected_(other.is_connected_) {}
  RawClient(const RawClient&) = delete;
  ~RawClient() {
    if (socket_ >= 0) close(socket_);
  }

  bool is_connected() const { return is_connected_; }

  /// Returns false once the server has closed the connection or stops reading.
  bool send(std::string_view bytes) {
    while (!bytes.empty()) {
      const ssize_t n = ::send(socket_, bytes.data(), bytes.size(), MSG_NOSIGNAL);
      if (n <= 0) return false;
      bytes.remove_prefix(static_cast<std::size_t>(n));
    }
    return true;
  }

  /// Reads until the server closes the connection. Returns false if it does not.
  bool is_closed_by_server() {
    char bytes[4096];
    for (;;) {
      const ssize_t n = recv(socket_, bytes, sizeof bytes, 0);
      if (n == 0 || (n < 0 && errno == ECONNRESET)) return true;
      if (n < 0) return false;
    }
  }

  /// Returns the next complete answer, with as much of its body as Content-Length says.
  std::optional<HttpAnswer> answer() {
    std::string text;
    std::size_t end = std::string::npos;
    while ((end = text.find("\r\n\r\n")) == std::string::npos) {
      if (!receive(text)) return std::nullopt;
    }
    HttpAnswer answer;
    if (text.compare(0, 7, "HTTP/1.") != 0) return std::nullopt;
    answer.status = std::atoi(text.c_str() + 9);
    for (std::size_t at = text.find("\r\n") + 2; at < end + 2;) {
      const std::size_t line_end = text.find("\r\n", at), colon = text.find(": ", at);
      answer.headers.emplace(text.substr(at, colon - at), text.substr(colon + 2, line_end - colon - 2));
      at = line_end + 2;
    }
    const auto length = static_cast<std::size_t>(std::atol(answer.header("Content-Length").c_str()));
    answer.body = text.substr(end + 4);
    while (answer.body.size() < length) {
      if (!receive(answer.body)) return std::nullopt;
    }
    return answer;
  }

 private:
  bool receive(std::string& to) {
    char bytes[4096];
    const ssize_t n = recv(socket_, bytes, sizeof bytes, 0);
    if (n > 0) to.append(bytes, static_cast<std::size_t>(n));
    return n > 0;
  }

  int socket_;
  bool is_connected_ = false;
};

/// Returns the text of a request.
inline std::string http_request(const std::string& method, const std::string& path, HttpHeaders headers,
                                const std::string& body = {}) {
  headers.emplace("Content-Length", std::to_string(body.size()));
  if (headers.count("Host") == 0) headers.emplace("Host", "127.0.0.1");
  std::string text = method + " " + path + " HTTP/1.1\r\n";
  for (const auto& [name, value] : headers) text += name + ": " + value + "\r\n";
  return text + "\r\n" + body;
}

/// Sends each request on a new connection.
class HttpClient {
 public:
  explicit HttpClient(int port) : port_(port) {}

  std::optional<HttpAnswer> request(const std::string& method, const std::string& path, HttpHeaders headers,
                                    const std::string& body = {}) const {
    if (headers.count("Host") == 0) headers.emplace("Host", "127.0.0.1:" + std::to_string(port_));
    RawClient client(port_);
    client.send(http_request(method, path, headers, body));
    return client.answer();
  }
  std::optional<HttpAnswer> get(const std::string& path, const HttpHeaders& headers = {}) const {
    return request("GET", path, headers);
  }
  std::optional<HttpAnswer> post(const std::string& path, const HttpHeaders& headers, const std::string& body) const {
    return request("POST", path, headers, body);
  }

 private:
  int port_;
};

}  // namespace b3dgs::test
