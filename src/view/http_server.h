// HTTP for clients that are taken for hostile: whatever they send or leave out, the server holds a bounded number of
// connections, bytes and threads, and ends when it is told to.
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

  /// The first value, or "".
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
  std::vector<std::pair<std::string, std::string>> headers;  // besides Content-Type
};

inline HttpResponse text_response(int status, const std::string& line) {
  return {status, "text/plain; charset=utf-8", line + "\n", {}};
}

/// What the server is asked. No function may throw.
class HttpHandler {
 public:
  virtual ~HttpHandler() = default;
  /// Called before the body is read: the answer to a request that is not allowed, whose connection is closed then.
  /// Connections whose request was allowed are not closed for the sake of others.
  virtual std::optional<HttpResponse> refuse(const HttpRequest& request) = 0;
  /// Whether answer() takes long, and is to be called on a thread that others need not wait for.
  virtual bool is_slow(const HttpRequest& request) const = 0;
  virtual HttpResponse answer(const HttpRequest& request) = 0;
  /// Adds to the server's own answers what all answers have.
  virtual void complete(HttpResponse& response) const = 0;
};

struct HttpLimits {
  std::size_t connections = 64;            // at the same time; before that many are open, the oldest stranger is cut
  std::size_t head_bytes = 32768;          // of memory for a connection: request line, headers and what is made of them
  std::size_t body_bytes = 4096;           // of a request
  std::size_t slow_answers = 5;            // at the same time
  std::chrono::milliseconds to_ask{5000};  // for a whole request, from the connection or the end of the last answer on
  std::chrono::milliseconds to_take{60000};  // for a client to take an answer
};

class HttpServer {
 public:
  /// `handler` must outlive it. @throws InputError if this program was built without a web server
  HttpServer(HttpHandler& handler, const HttpLimits& limits);
  /// Waits for answers in work, but for no client.
  ~HttpServer();
  HttpServer(const HttpServer&) = delete;
  HttpServer& operator=(const HttpServer&) = delete;

  /// Listens, and answers on threads of its own from now on. Port 0: any free one. Returns the port, or nothing if the
  /// address or port cannot be used.
  std::optional<int> listen(const std::string& address, int port);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace b3dgs
