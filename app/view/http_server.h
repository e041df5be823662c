// HTTP for untrusted clients. Regardless of their requests, the number of connections, bytes and threads is limited,
// and the server ends when requested.
#pragma once

#include <chrono>
#include <cstddef>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace b3dgs {

struct HttpRequest {
  using Fields = std::multimap<std::string, std::string>;
  std::string method, path, body;
  Fields headers;     // names in lower case
  Fields parameters;  // of the query, decoded

  /// Returns the first value, or "".
  static std::string first(const Fields& fields, const std::string& name) {
    const auto found = fields.find(name);
    return found == fields.end() ? std::string() : found->second;
  }
  std::string header(const std::string& name) const { return first(headers, name); }
  std::string parameter(const std::string& name) const { return first(parameters, name); }
};

struct HttpResponse {
  int status = 200;
  std::string type, body;
  std::vector<std::pair<std::string, std::string>> headers;  // in addition to Content-Type
};

inline HttpResponse text_response(int status, const std::string& line) {
  return {status, "text/plain; charset=utf-8", line + "\n", {}};
}

/// Answers the requests to the server. No function may throw.
class HttpHandler {
 public:
  virtual ~HttpHandler() = default;
  /// Called before the body is read. Returns the answer to a request that is not allowed, after which its connection is
  /// closed. Connections with an allowed request are not closed to make space for others.
  virtual std::optional<HttpResponse> refuse(const HttpRequest& request) = 0;
  /// Returns whether answer() takes long, and has to run on a thread that others need not wait for.
  virtual bool is_slow(const HttpRequest& request) const = 0;
  virtual HttpResponse answer(const HttpRequest& request) = 0;
  /// Adds the common headers to the server's own answers.
  virtual void complete(HttpResponse& response) const = 0;
};

struct HttpLimits {
  std::size_t connections = 64;            // at the same time; before that many are open, the oldest stranger is cut
  std::size_t head_bytes = 32768;          // memory for a connection: request line, headers and data derived from them
  std::size_t body_bytes = 4096;           // limit of a request
  std::size_t slow_answers = 5;            // at the same time
  std::chrono::milliseconds to_ask{5000};  // for a whole request, from the connection or the end of the last answer
  std::chrono::milliseconds to_take{60000};  // for a client to take an answer
};

class HttpServer {
 public:
  /// `handler` must outlive it. @throws InputError if this program was built without a web server
  HttpServer(HttpHandler& handler, const HttpLimits& limits);
  /// Waits for answers in progress, but not for clients.
  ~HttpServer();
  HttpServer(const HttpServer&) = delete;
  HttpServer& operator=(const HttpServer&) = delete;

  /// Listens, and answers on its own threads from now on. Port 0 means any free one. Returns the port, or nothing if
  /// the address or port cannot be used.
  std::optional<int> listen(const std::string& address, int port);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace b3dgs
