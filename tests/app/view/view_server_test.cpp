// The server from the view of an HTTP client, with a source that paints one colour.
#include "app/view/view_server.h"

#include <gtest/gtest.h>

#include <atomic>
#include <condition_variable>
#include <cstring>
#include <mutex>
#include <nlohmann/json.hpp>
#include <opencv2/imgcodecs.hpp>
#include <thread>

#include "support/expect_error.h"
#include "support/http_client.h"

namespace b3dgs {
namespace {

using nlohmann::json;
using Answer = std::optional<test::HttpAnswer>;

class OneColor final : public FrameSource {
 public:
  OneColor() {
    scene_.title = "one colour";
    scene_.views.resize(1);
    scene_.views[0].name = "a.jpg";
    scene_.views[0].has_photograph = true;
    scene_.views[0].camera.width = 64;
    scene_.views[0].camera.height = 48;
    scene_.views[0].camera.fx = scene_.views[0].camera.fy = 50;
  }

  const ViewedScene& scene() const override { return scene_; }
  ViewState state(int since) const override {
    ViewState state;
    state.iteration = 7;
    state.has_ended = has_ended;
    state.curve = {{since + 1, 0.5, 100}};
    return state;
  }
  Frame render(const FrameRequest& request) override {
    ++frames;
    if (fails) throw NumericError("first line\nsecond line");
    wait();
    Frame frame;
    frame.image = Image8(request.camera.width, request.camera.height, 3);
    for (std::size_t i = 0; i < frame.image.pixels.size(); i += 3) frame.image.pixels[i] = 200;  // red
    frame.iteration = 7;
    frame.legend = "red";
    frame.wait_s = 1.5;
    return frame;
  }
  Image8 photograph(int, ImageSize size) const override {
    ++photographs;
    wait();
    return Image8(size.width, size.height, 3);
  }
  void command(ViewCommand command) override { commands.push_back(command); }
  bool is_stopped() const override { return has_stop; }
  void close() override {
    has_ended = true;
    hold(false);
  }
  void train() { scene_.is_training = true; }

  /// Makes frames and photographs wait while `is_held`.
  void hold(bool is_held) {
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      is_held_ = is_held;
    }
    changed_.notify_all();
  }

  std::atomic<int> frames{0};
  mutable std::atomic<int> photographs{0};
  std::atomic<bool> fails{false}, has_ended{false}, has_stop{false};
  std::vector<ViewCommand> commands;

 private:
  void wait() const {
    std::unique_lock<std::mutex> lock(mutex_);
    changed_.wait(lock, [&] { return !is_held_; });
  }

  ViewedScene scene_;
  mutable std::mutex mutex_;
  mutable std::condition_variable changed_;
  bool is_held_ = false;
};

class Server : public ::testing::Test {
 protected:
  Server() : server_(source_, options()), client_(server_.port()) {}

  static ViewServerOptions options() {
    ViewServerOptions options;
    options.port = 0;
    return options;
  }
  test::HttpHeaders headers(const std::string& client = "me") const {
    return {{"X-Token", server_.token()}, {"X-Client", client}};
  }
  test::HttpHeaders and_header(const std::string& name, const std::string& value) const {
    test::HttpHeaders all = headers();
    all.emplace(name, value);
    return all;
  }
  Answer post(const std::string& path, const std::string& body) { return client_.post(path, headers(), body); }

  OneColor source_;
  ViewServer server_;
  const test::HttpClient client_;
};

/// Checks the status of an answer, and that its body is one line.
void expect_refused(const Answer& result, int status) {
  ASSERT_TRUE(result);
  EXPECT_EQ(result->status, status) << result->body;
  ASSERT_FALSE(result->body.empty());
  EXPECT_EQ(result->body.find('\n'), result->body.size() - 1) << result->body;
}

const char* const kFrame = R"({"width":64,"height":48,"view":0})";

TEST_F(Server, ThePageNeedsTheToken) {
  expect_refused(client_.get("/"), 401);
  expect_refused(client_.get("/?token=0123"), 401);
  expect_refused(client_.get("/", headers()), 401);
  const Answer page = client_.get("/?token=" + server_.token());
  ASSERT_TRUE(page);
  EXPECT_EQ(page->status, 200);
  EXPECT_NE(page->body.find("<canvas"), std::string::npos);
  EXPECT_EQ(page->body.find(server_.token()), std::string::npos);
}

TEST_F(Server, EverythingElseNeedsTheTokenAsAHeader) {
  for (const char* path :
       {"/cameras", "/state", "/photograph?view=0&width=64&height=48", "/nothing", "/../etc/passwd"}) {
    SCOPED_TRACE(path);
    expect_refused(client_.get(path), 401);
    expect_refused(client_.get(std::string(path) + (std::strchr(path, '?') ? "&" : "?") + "token=" + server_.token()),
                   401);
  }
  expect_refused(client_.post("/frame", {}, kFrame), 401);
  expect_refused(client_.post("/command", {}, R"({"command":"stop"})"), 401);
  test::HttpHeaders wrong = headers();
  wrong.find("X-Token")->second.back() ^= 1;
  expect_refused(client_.post("/command", wrong, R"({"command":"stop"})"), 401);
  EXPECT_EQ(source_.frames, 0);
  EXPECT_TRUE(source_.commands.empty());
}

TEST_F(Server, OtherHostNamesAreRefused) {
  for (const char* host : {"evil.example", "evil.example:8080", "192.168.0.1:8080"}) {
    expect_refused(client_.get("/?token=" + server_.token(), {{"Host", host}}), 403);
    expect_refused(client_.get("/state", and_header("Host", host)), 403);
  }
  EXPECT_EQ(client_.get("/state", and_header("Host", "localhost:1"))->status, 200) << "a tunnel's port";
}

TEST_F(Server, OtherOriginsAreRefused) {
  for (const char* origin : {"http://evil.example", "null", "https://127.0.0.1"}) {
    expect_refused(client_.post("/command", and_header("Origin", origin), R"({"command":"stop"})"), 403);
  }
  EXPECT_TRUE(source_.commands.empty());
  const std::string own = "http://127.0.0.1:" + std::to_string(server_.port());
  EXPECT_EQ(client_.post("/command", and_header("Origin", own), R"({"command":"pause"})")->status, 200);
  EXPECT_EQ(source_.commands, std::vector<ViewCommand>{ViewCommand::kPause});
}

TEST_F(Server, NoAnswerIsForOtherSites) {
  for (const char* path : {"/state", "/cameras", "/nothing"}) {
    const Answer result = client_.get(path, headers());
    ASSERT_TRUE(result) << path;
    EXPECT_FALSE(result->headers.count("Access-Control-Allow-Origin")) << path;
    EXPECT_EQ(result->header("X-Content-Type-Options"), "nosniff") << path;
    EXPECT_EQ(result->header("Referrer-Policy"), "no-referrer") << path;
    EXPECT_EQ(result->header("Cache-Control"), "no-store") << path;
    EXPECT_EQ(result->header("Content-Security-Policy"), "default-src 'none'; frame-ancestors 'none'") << path;
  }
  const Answer preflight = client_.request("OPTIONS", "/frame", {{"Origin", "http://evil.example"}});
  ASSERT_TRUE(preflight);
  EXPECT_NE(preflight->status, 200);
  EXPECT_FALSE(preflight->headers.count("Access-Control-Allow-Origin"));
}

TEST_F(Server, ThePageRunsItsOwnScriptOnly) {
  const Answer one = client_.get("/?token=" + server_.token());
  const Answer two = client_.get("/?token=" + server_.token());
  ASSERT_TRUE(one && two);
  EXPECT_EQ(one->headers.count("Content-Security-Policy"), 1u);
  const std::string policy = one->header("Content-Security-Policy");
  EXPECT_NE(policy, two->header("Content-Security-Policy")) << "a nonce serves once";
  for (const char* part : {"default-src 'none'", "connect-src 'self'", "frame-ancestors 'none'", "base-uri 'none'"}) {
    EXPECT_NE(policy.find(part), std::string::npos) << policy;
  }
  EXPECT_EQ(policy.find("unsafe"), std::string::npos) << policy;
  const std::size_t at = policy.find("'nonce-");
  ASSERT_NE(at, std::string::npos);
  const std::string nonce = policy.substr(at + 7, 32);
  EXPECT_NE(one->body.find("<script nonce=\"" + nonce + "\">"), std::string::npos);
  EXPECT_NE(one->body.find("<style nonce=\"" + nonce + "\">"), std::string::npos);
  EXPECT_EQ(one->body.find('@' + std::string("NONCE")), std::string::npos);
  const std::string notice = "https://github.com/leeoniya/uPlot";  // in a comment
  std::string body = one->body;
  body.erase(body.find(notice), notice.size());
  for (const char* outside : {"http://", "https://", " src=", "@import", "url("}) {
    EXPECT_EQ(body.find(outside), std::string::npos) << outside << ": the page needs no other file";
  }
}

TEST_F(Server, FramesAreJpegsOfTheSize) {
  const Answer result = post("/frame", kFrame);
  ASSERT_TRUE(result);
  ASSERT_EQ(result->status, 200) << result->body;
  EXPECT_EQ(result->header("Content-Type"), "image/jpeg");
  const json about = json::parse(result->header("X-Frame"));
  EXPECT_EQ(about["iteration"], 7);
  EXPECT_EQ(about["legend"], "red");
  EXPECT_EQ(about["wait_ms"], 1500);
  const std::vector<unsigned char> bytes(result->body.begin(), result->body.end());
  const cv::Mat image = cv::imdecode(bytes, cv::IMREAD_COLOR);
  ASSERT_EQ(image.cols, 64);
  ASSERT_EQ(image.rows, 48);
  const cv::Vec3b bgr = image.at<cv::Vec3b>(20, 20);
  EXPECT_NEAR(bgr[2], 200, 3);
  EXPECT_NEAR(bgr[0], 0, 3);
}

TEST_F(Server, StateCamerasAndPhotographs) {
  EXPECT_EQ(json::parse(client_.get("/cameras", headers())->body)["views"][0]["name"], "a.jpg");
  const json state = json::parse(client_.get("/state?since=4", headers())->body);
  EXPECT_EQ(state["iteration"], 7);
  EXPECT_EQ(state["curve"][0][0], 5);
  const Answer photograph = client_.get("/photograph?view=0&width=32&height=32", headers());
  ASSERT_EQ(photograph->status, 200);
  EXPECT_EQ(photograph->header("Content-Type"), "image/jpeg");
}

TEST_F(Server, BadRequestsAreOneLineAndHarmless) {
  for (const char* body : {"", "{", "[1,2]", R"({"width":1e999,"height":1,"view":0})", R"({"width":64,"height":48})",
                           R"({"width":40000,"height":40000,"view":0})", R"({"width":64,"height":48,"view":99})",
                           R"({"width":64,"height":48,"camera":{"camera_to_world":[null],"fov":50}})"}) {
    expect_refused(post("/frame", body), 400);
  }
  expect_refused(post("/command", R"({"command":"rm"})"), 400);
  for (const char* query : {"", "?view=0", "?view=-1&width=64&height=48", "?view=9&width=64&height=48",
                            "?view=0&width=9999&height=9999", "?view=../../etc/passwd&width=64&height=48"}) {
    expect_refused(client_.get(std::string("/photograph") + query, headers()), 400);
  }
  expect_refused(client_.get("/state?since=x", headers()), 400);
  expect_refused(client_.get("/etc/passwd", headers()), 404);
  EXPECT_EQ(source_.frames, 0);
  EXPECT_EQ(post("/frame", kFrame)->status, 200);
}

TEST_F(Server, BodiesAreLimited) {
  const std::string spaces(HttpLimits().body_bytes, ' ');
  expect_refused(client_.post("/frame", headers(), kFrame + spaces), 413);
  test::HttpHeaders chunked = and_header("Transfer-Encoding", "chunked");
  expect_refused(client_.post("/frame", chunked, kFrame), 411);
  EXPECT_EQ(source_.frames, 0);
  EXPECT_EQ(post("/frame", kFrame)->status, 200);
}

TEST_F(Server, AnErrorOfTheRendererIsOneLine) {
  source_.fails = true;
  const Answer result = post("/frame", kFrame);
  expect_refused(result, 500);
  EXPECT_EQ(result->body, "first line\n");
  source_.fails = false;
  EXPECT_EQ(post("/frame", kFrame)->status, 200);
}

TEST_F(Server, FourClientsAtOnce) {
  for (const char* name : {"a", "b", "c", "d"}) EXPECT_EQ(client_.get("/state", headers(name))->status, 200);
  expect_refused(client_.get("/state", headers("e")), 503);
  expect_refused(client_.post("/frame", headers("e"), kFrame), 503);
  EXPECT_EQ(client_.get("/state", headers("a"))->status, 200);
}

TEST_F(Server, OneFrameInWorkForEachClient) {
  source_.hold(true);
  std::thread first([&] { EXPECT_EQ(client_.post("/frame", headers("a"), kFrame)->status, 200); });
  while (source_.frames == 0) std::this_thread::yield();
  expect_refused(client_.post("/frame", headers("a"), kFrame), 503);
  EXPECT_EQ(source_.frames, 1);
  EXPECT_EQ(client_.get("/state", headers("a"))->status, 200) << "only frames wait";
  source_.hold(false);
  first.join();
  EXPECT_EQ(client_.post("/frame", headers("a"), kFrame)->status, 200);
}

TEST_F(Server, PhotographsCountAsFrames) {
  const std::string path = "/photograph?view=0&width=32&height=32";
  source_.hold(true);
  std::thread first([&] { EXPECT_EQ(client_.get(path, headers("a"))->status, 200); });
  while (source_.photographs == 0) std::this_thread::yield();
  expect_refused(client_.get(path, headers("a")), 503);
  expect_refused(client_.post("/frame", headers("a"), kFrame), 503);
  EXPECT_EQ(source_.photographs, 1);
  EXPECT_EQ(source_.frames, 0);
  source_.hold(false);
  first.join();
  EXPECT_EQ(client_.get(path, headers("a"))->status, 200);
}

TEST_F(Server, LongRangesAreHarmless) {
  for (const std::size_t n : {std::size_t{2600}, std::size_t{7000}}) {
    std::string ranges = "bytes=0-";
    for (std::size_t i = 0; i < n; ++i) ranges += ",0-";
    EXPECT_EQ(client_.get("/state", and_header("Range", ranges))->status, 200);
  }
}

TEST_F(Server, SaysWhereThePageIs) {
  const std::string port = std::to_string(server_.port());
  EXPECT_EQ(server_.url(), "http://127.0.0.1:" + port + "/?token=" + server_.token());
  const std::string text = server_.instructions();
  EXPECT_NE(text.find(server_.url()), std::string::npos);
  EXPECT_NE(text.find("ssh -N -L " + port + ":127.0.0.1:" + port + " "), std::string::npos) << text;
}

TEST_F(Server, OnAllAddressesNamesOneThatOtherMachinesReach) {
  ViewServerOptions all;
  all.address = "0.0.0.0";
  all.port = 0;
  OneColor source;
  const ViewServer server(source, all);
  const std::string text = server.instructions(), other = "from another machine: http://";
  ASSERT_NE(text.find(other), std::string::npos) << text;
  const std::string rest = text.substr(text.find(other) + other.size());
  EXPECT_NE(rest.rfind("127.", 0), 0u) << text;
  EXPECT_NE(rest.rfind("0.0.0.0", 0), 0u) << text;
  EXPECT_NE(rest.find(":" + std::to_string(server.port()) + "/?token=" + server.token()), std::string::npos) << text;
}

TEST_F(Server, ATakenPortIsOneLine) {
  ViewServerOptions taken;
  taken.port = server_.port();
  OneColor other;
  EXPECT_TRUE(test::fails_with<InputError>({std::to_string(server_.port()), "taken", "choose another port"},
                                           [&] { ViewServer(other, taken); }));
}

TEST(ViewServer, WithoutAPortTakesTheNextFreeOne) {
  OneColor one, two;
  const ViewServer first(one, {}), second(two, {});
  EXPECT_GE(first.port(), kFirstViewPort);
  EXPECT_GT(second.port(), first.port());
  EXPECT_NE(first.token(), second.token());
}

TEST(ViewServer, AnAddressThatIsNotThisMachinesIsOneLine) {
  OneColor source;
  for (const char* address : {"203.0.113.1", "no such address"}) {
    ViewServerOptions options;
    options.address = address;
    options.port = 0;
    EXPECT_TRUE(test::fails_with<InputError>({address}, [&] { ViewServer(source, options); }));
  }
}

TEST(ViewServer, TellsThePageOfATrainingThatItHasEnded) {
  OneColor source;
  source.train();
  std::thread page;
  Answer last;
  {
    ViewServerOptions options;
    options.port = 0;
    const ViewServer server(source, options);
    const auto ask = [port = server.port(), headers = test::HttpHeaders{{"X-Token", server.token()}}] {
      return test::HttpClient(port).get("/state", headers);
    };
    EXPECT_EQ(json::parse(ask()->body)["ended"], false);
    page = std::thread([&source, &last, ask] {
      while (!source.has_ended) std::this_thread::yield();
      std::this_thread::sleep_for(std::chrono::milliseconds(200));
      last = ask();
    });
  }
  page.join();
  ASSERT_TRUE(last);
  EXPECT_EQ(json::parse(last->body)["ended"], true);
}

TEST_F(Server, AStopEndsTheWaitForPages) {
  using Clock = std::chrono::steady_clock;
  OneColor source;
  source.train();
  std::thread user;
  const Clock::time_point start = Clock::now();
  {
    const ViewServer server(source, options());
    test::HttpClient(server.port()).get("/state", {{"X-Token", server.token()}});
    user = std::thread([&] {
      while (!source.has_ended) std::this_thread::yield();
      source.has_stop = true;
    });
  }
  EXPECT_LT(Clock::now() - start, std::chrono::seconds(2));
  user.join();
}

TEST(ViewServer, EndsWhileAFrameWaits) {
  OneColor source;
  source.hold(true);
  std::thread asker;
  {
    ViewServerOptions options;
    options.port = 0;
    const ViewServer server(source, options);
    asker = std::thread([&, port = server.port(), token = server.token()] {
      test::HttpClient(port).post("/frame", {{"X-Token", token}}, kFrame);
    });
    while (source.frames == 0) std::this_thread::yield();
  }
  asker.join();
}

}  // namespace
}  // namespace b3dgs
