// The server against hostile clients, over sockets. Deadlines that a test does not wait for are long, so that only the
// tested limit ends its connections.
#include "app/view/http_server.h"

#include <gtest/gtest.h>

#include <atomic>
#include <condition_variable>
#include <filesystem>
#include <functional>
#include <mutex>
#include <thread>

#include "support/http_client.h"

namespace b3dgs {
namespace {

using std::chrono::milliseconds;
using test::http_request;
using test::RawClient;

constexpr std::size_t kMebibyte = 1 << 20;

/// Allows requests with "X-Key: right".
class Handler final : public HttpHandler {
 public:
  std::optional<HttpResponse> refuse(const HttpRequest& request) override {
    ++asked;
    if (request.header("x-key") == "right") return std::nullopt;
    return text_response(401, "no");
  }
  bool is_slow(const HttpRequest& request) const override { return request.path == "/slow"; }
  HttpResponse answer(const HttpRequest& request) override {
    ++answered;
    if (request.path == "/large") return {200, "text/plain", std::string(32 * kMebibyte, ' '), {}};
    if (request.path == "/slow") {
      std::unique_lock<std::mutex> lock(mutex_);
      changed_.wait(lock, [&] { return !is_held_; });
    }
    return {200, "text/plain", request.path + " " + request.body, {}};
  }
  void complete(HttpResponse&) const override {}

  /// Makes slow answers wait while `is_held`.
  void hold(bool is_held) {
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      is_held_ = is_held;
    }
    changed_.notify_all();
  }

  std::atomic<int> asked{0}, answered{0};

 private:
  std::mutex mutex_;
  std::condition_variable changed_;
  bool is_held_ = false;
};

HttpLimits patient() {
  HttpLimits limits;
  limits.to_ask = limits.to_take = milliseconds(600000);
  return limits;
}

struct Running {
  explicit Running(const HttpLimits& limits = patient()) : server(std::make_unique<HttpServer>(handler, limits)) {
    port = server->listen("127.0.0.1", 0).value();
  }
  ~Running() { handler.hold(false); }

  std::string request(const std::string& path, const std::string& body = {}) const {
    return http_request("POST", path, {{"X-Key", "right"}}, body);
  }
  void expect_answer() const {
    RawClient client(port);
    client.send(request("/fast", "body"));
    const auto answer = client.answer();
    ASSERT_TRUE(answer) << "no answer to the owner";
    EXPECT_EQ(answer->status, 200);
    EXPECT_EQ(answer->body, "/fast body");
  }

  Handler handler;
  std::unique_ptr<HttpServer> server;
  int port = 0;
};

std::ptrdiff_t n_open_files() {
  const std::filesystem::directory_iterator files("/proc/self/fd");
  return std::distance(begin(files), end(files));
}

bool comes_true(const std::function<bool()>& condition) {
  for (int i = 0; i < 30000; ++i) {
    if (condition()) return true;
    std::this_thread::sleep_for(milliseconds(1));
  }
  return false;
}

/// Sends `piece` repeatedly. Returns the number of bytes sent before the server closed the connection.
std::size_t flood(RawClient& client, const std::string& piece, std::size_t most = 256 * kMebibyte) {
  std::size_t n = 0;
  while (n < most && client.send(piece)) n += piece.size();
  return n;
}

TEST(HttpServer, AnswersSeveralRequestsOnOneConnection) {
  const Running running;
  RawClient client(running.port);
  for (const char* path : {"/fast", "/slow", "/fast"}) {
    ASSERT_TRUE(client.send(running.request(path, "body")));
    const auto answer = client.answer();
    ASSERT_TRUE(answer) << path;
    EXPECT_EQ(answer->body, std::string(path) + " body");
  }
}

TEST(HttpServer, RefusedRequestsEndTheConnection) {
  const Running running;
  RawClient client(running.port);
  ASSERT_TRUE(client.send(http_request("GET", "/fast", {})));
  const auto answer = client.answer();
  ASSERT_TRUE(answer);
  EXPECT_EQ(answer->status, 401);
  EXPECT_TRUE(client.is_closed_by_server());
  EXPECT_EQ(running.handler.answered, 0);
}

TEST(HttpServer, AnEndlessHeadIsCut) {
  const Running running;
  const std::string letters(65536, 'a');
  std::string lines;
  while (lines.size() < 65536) lines += "a: b\r\n";
  for (const auto& [begin, piece] : {std::pair<std::string, std::string>("GET /", letters),
                                     {"GET / HTTP/1.1\r\nX: ", letters},
                                     {"GET / HTTP/1.1\r\n", lines},
                                     {"GET /?", "a=b&"},
                                     {"", std::string(65536, '\0')},
                                     {"", "\r\n\r\n\r\n\r\n"}}) {
    RawClient client(running.port);
    client.send(begin);
    EXPECT_LT(flood(client, piece), 64 * kMebibyte) << begin << piece.substr(0, 8);
  }
  EXPECT_EQ(running.handler.asked, 0);
  running.expect_answer();
}

TEST(HttpServer, BodiesAreLimited) {
  const Running running;
  const std::size_t limit = HttpLimits().body_bytes;
  const auto status_of = [&](const std::string& length, const std::string& more, const std::string& body) {
    RawClient client(running.port);
    client.send("POST /fast HTTP/1.1\r\nHost: a\r\nX-Key: right\r\n" +
                (length.empty() ? "" : "Content-Length: " + length + "\r\n") + more + "\r\n" + body);
    const auto answer = client.answer();
    return answer ? answer->status : 0;
  };
  EXPECT_EQ(status_of(std::to_string(limit), "", std::string(limit, 'x')), 200);
  EXPECT_EQ(running.handler.answered, 1);
  EXPECT_EQ(status_of(std::to_string(limit + 1), "", std::string(limit + 1, 'x')), 413);
  EXPECT_EQ(status_of("99999999999", "", "x"), 413);
  EXPECT_NE(status_of("99999999999999999999999999", "", "x"), 200);
  EXPECT_NE(status_of("-1", "", "x"), 200);
  EXPECT_NE(status_of("1x", "", "x"), 200);
  EXPECT_EQ(status_of("", "Transfer-Encoding: chunked\r\n", "1\r\nx\r\n0\r\n\r\n"), 411);
  EXPECT_NE(status_of("1", "Transfer-Encoding: chunked\r\n", "1\r\nx\r\n0\r\n\r\n"), 200);
  EXPECT_EQ(running.handler.answered, 1);
}

TEST(HttpServer, EndlessChunksAreCut) {
  const Running running;
  RawClient client(running.port);
  client.send("POST /fast HTTP/1.1\r\nHost: a\r\nX-Key: right\r\nTransfer-Encoding: chunked\r\n\r\n");
  EXPECT_LT(flood(client, "1000\r\n" + std::string(4096, 'x') + "\r\n"), 64 * kMebibyte);
  EXPECT_EQ(running.handler.answered, 0);
}

TEST(HttpServer, IdleConnectionsMakeRoomForTheOwner) {
  const std::ptrdiff_t before = n_open_files();
  const Running running;
  const std::ptrdiff_t of_server = n_open_files() - before;
  std::vector<RawClient> idle;
  for (int i = 0; i < 300; ++i) {
    idle.emplace_back(running.port);
    ASSERT_TRUE(idle.back().is_connected());
    if (i % 3 == 0) idle.back().send("GET / HTTP/1.1\r\n");
  }
  running.expect_answer();
  EXPECT_LE(n_open_files() - before - of_server - 300, static_cast<std::ptrdiff_t>(HttpLimits().connections));
  EXPECT_TRUE(idle.front().is_closed_by_server()) << "the oldest go first";
  running.expect_answer();
}

TEST(HttpServer, TheOwnersConnectionsOutliveStrangers) {
  Running running;
  RawClient owner(running.port), resting(running.port);
  ASSERT_TRUE(resting.send(running.request("/fast")));
  ASSERT_TRUE(resting.answer());
  running.handler.hold(true);
  ASSERT_TRUE(owner.send(running.request("/slow", "mine")));
  ASSERT_TRUE(comes_true([&] { return running.handler.answered == 2; }));
  std::vector<RawClient> idle;
  for (int i = 0; i < 300; ++i) idle.emplace_back(running.port);
  running.expect_answer();
  running.handler.hold(false);
  const auto answer = owner.answer();
  ASSERT_TRUE(answer);
  EXPECT_EQ(answer->body, "/slow mine");
  ASSERT_TRUE(resting.send(running.request("/fast")));
  EXPECT_TRUE(resting.answer());
}

TEST(HttpServer, TricklingClientsAreCut) {
  HttpLimits limits = patient();
  limits.to_ask = milliseconds(50);
  const Running running(limits);
  for (const char* begin : {"", "GET / HTTP/1.1\r\nX: ",
                            "POST /fast HTTP/1.1\r\nHost: a\r\nX-Key: right\r\nContent-Length: 4000\r\n\r\n"}) {
    RawClient client(running.port);
    client.send(begin);
    EXPECT_TRUE(comes_true([&] { return !client.send("a"); })) << begin;
  }
  RawClient silent(running.port);
  EXPECT_TRUE(silent.is_closed_by_server());
  EXPECT_EQ(running.handler.answered, 0);
}

TEST(HttpServer, RestingConnectionsAreClosed) {
  HttpLimits limits = patient();
  limits.to_ask = milliseconds(100);
  const Running running(limits);
  const auto is_closed_after_its_answer = [&] {
    RawClient client(running.port);
    client.send(running.request("/fast"));
    return client.answer() && client.is_closed_by_server();
  };
  EXPECT_TRUE(comes_true(is_closed_after_its_answer)) << "at once, unless this thread had to wait before it asked";
}

TEST(HttpServer, ClientsThatDoNotTakeTheirAnswerAreCut) {
  HttpLimits limits = patient();
  limits.to_take = milliseconds(50);
  const Running running(limits);
  const std::ptrdiff_t before = n_open_files();
  RawClient client(running.port);
  client.send(running.request("/large"));
  EXPECT_TRUE(comes_true([&] { return running.handler.answered == 1 && n_open_files() == before + 1; }));
}

TEST(HttpServer, SlowAnswersDoNotHoldUpOthers) {
  Running running;
  running.handler.hold(true);
  std::vector<RawClient> waiting;
  const std::size_t n = 2 * HttpLimits().slow_answers;
  for (std::size_t i = 0; i < n; ++i) {
    waiting.emplace_back(running.port);
    waiting.back().send(running.request("/slow", std::to_string(i)));
  }
  ASSERT_TRUE(comes_true([&] { return running.handler.answered == static_cast<int>(HttpLimits().slow_answers); }));
  running.handler.hold(true);
  RawClient fast(running.port);
  fast.send(running.request("/fast"));
  EXPECT_TRUE(fast.answer());
  running.handler.hold(false);
  for (std::size_t i = 0; i < n; ++i) {
    const auto answer = waiting[i].answer();
    ASSERT_TRUE(answer) << i;
    EXPECT_EQ(answer->body, "/slow " + std::to_string(i));
  }
}

TEST(HttpServer, WhatIsNotHttpIsHarmless) {
  const Running running;
  for (const std::string& bytes :
       {std::string("\r\n\r\n"), std::string("GET\r\n\r\n"), std::string("GET / HTTP/9.9\r\n\r\n"),
        std::string("GET /%zz%00?%=%&&=&a HTTP/1.1\r\nHost: a\r\nX-Key: right\r\n\r\n"),
        std::string("GET / HTTP/1.1\r\n: \r\n \r\nHost\r\n\r\n"), std::string("\x16\x03\x01\x02\x00\x01", 6),
        std::string("GET / HTTP/1.1\r\nHost: a\r\nContent-Length: 1\r\nContent-Length: 2\r\n\r\nab"),
        std::string(
            "POST / HTTP/1.1\r\nHost: a\r\nX-Key: right\r\nExpect: 100-continue\r\nContent-Length: 9\r\n\r\n")}) {
    RawClient client(running.port);
    ASSERT_TRUE(client.send(bytes));
  }
  running.expect_answer();
}

TEST(HttpServer, EndsWhileClientsHang) {
  Running running;
  std::vector<RawClient> hanging;
  for (const std::string& begin :
       {std::string(), std::string("GET / HT"), std::string("GET / HTTP/1.1\r\nX: y\r\n"),
        std::string("POST /fast HTTP/1.1\r\nHost: a\r\nX-Key: right\r\n") + "Content-Length: 9\r\n\r\nab"}) {
    for (int i = 0; i < 5; ++i) {
      hanging.emplace_back(running.port);
      ASSERT_TRUE(hanging.back().send(begin));
    }
  }
  hanging.emplace_back(running.port);
  ASSERT_TRUE(hanging.back().send(running.request("/large")));
  ASSERT_TRUE(comes_true([&] { return running.handler.answered == 1; }));
  running.handler.hold(true);
  for (int i = 0; i < 9; ++i) {
    hanging.emplace_back(running.port);
    ASSERT_TRUE(hanging.back().send(running.request("/slow")));
  }
  ASSERT_TRUE(comes_true([&] { return running.handler.answered == 6; }));
  running.handler.hold(false);
  running.server.reset();
  for (RawClient& client : hanging) EXPECT_TRUE(client.is_closed_by_server());
  EXPECT_FALSE(RawClient(running.port).is_connected());
}

TEST(HttpServer, ClosesItsFilesAtTheEnd) {
  const std::ptrdiff_t before = n_open_files();
  {
    const Running running;
    running.expect_answer();
    EXPECT_GT(n_open_files(), before);
  }
  EXPECT_EQ(n_open_files(), before);
}

}  // namespace
}  // namespace b3dgs
