// The server as an HTTP client sees it, with a source that paints one colour.
#include "view/view_server.h"

#include <gtest/gtest.h>
#include <httplib.h>

#include <atomic>
#include <condition_variable>
#include <cstring>
#include <mutex>
#include <nlohmann/json.hpp>
#include <opencv2/imgcodecs.hpp>
#include <thread>

#include "support/expect_error.h"

namespace b3dgs {
namespace {

using nlohmann::json;

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
    state.curve = {{since + 1, 0.5, 100}};
    return state;
  }
  Frame render(const FrameRequest& request) override {
    ++frames;
    if (fails) throw NumericError("first line\nsecond line");
    std::unique_lock<std::mutex> lock(mutex_);
    changed_.wait(lock, [&] { return !is_held_; });
    Frame frame;
    frame.image = Image8(request.camera.width, request.camera.height, 3);
    for (std::size_t i = 0; i < frame.image.pixels.size(); i += 3) frame.image.pixels[i] = 200;  // red
    frame.iteration = 7;
    frame.legend = "red";
    return frame;
  }
  Image8 photograph(int, ImageSize size) const override { return Image8(size.width, size.height, 3); }
  void command(ViewCommand command) override { commands.push_back(command); }
  void close() override { hold(false); }

  /// Frames wait while this holds.
  void hold(bool is_held) {
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      is_held_ = is_held;
    }
    changed_.notify_all();
  }

  std::atomic<int> frames{0};
  std::atomic<bool> fails{false};
  std::vector<ViewCommand> commands;

 private:
  ViewedScene scene_;
  std::mutex mutex_;
  std::condition_variable changed_;
  bool is_held_ = false;
};

class Server : public ::testing::Test {
 protected:
  Server() : server_(source_, options()), client_("127.0.0.1", server_.port()) {}

  static ViewServerOptions options() {
    ViewServerOptions options;
    options.port = 0;
    return options;
  }
  httplib::Headers headers(const std::string& client = "me") const {
    return {{"X-Token", server_.token()}, {"X-Client", client}};
  }
  httplib::Headers and_header(const std::string& name, const std::string& value) const {
    httplib::Headers all = headers();
    all.emplace(name, value);
    return all;
  }
  httplib::Result post(const std::string& path, const std::string& body) {
    return client_.Post(path, headers(), body, "application/json");
  }
  httplib::Client another() const { return httplib::Client("127.0.0.1", server_.port()); }

  OneColor source_;
  ViewServer server_;
  httplib::Client client_;
};

/// Status of an answer, and that its body is one line.
void expect_refused(const httplib::Result& result, int status) {
  ASSERT_TRUE(result) << httplib::to_string(result.error());
  EXPECT_EQ(result->status, status) << result->body;
  ASSERT_FALSE(result->body.empty());
  EXPECT_EQ(result->body.find('\n'), result->body.size() - 1) << result->body;
}

const char* const kFrame = R"({"width":64,"height":48,"view":0})";

TEST_F(Server, ThePageNeedsTheToken) {
  expect_refused(client_.Get("/"), 401);
  expect_refused(client_.Get("/?token=0123"), 401);
  expect_refused(client_.Get("/", headers()), 401);
  const httplib::Result page = client_.Get("/?token=" + server_.token());
  ASSERT_TRUE(page);
  EXPECT_EQ(page->status, 200);
  EXPECT_NE(page->body.find("<canvas"), std::string::npos);
  EXPECT_EQ(page->body.find(server_.token()), std::string::npos);
}

TEST_F(Server, EverythingElseNeedsTheTokenAsAHeader) {
  for (const char* path :
       {"/cameras", "/state", "/photograph?view=0&width=64&height=48", "/nothing", "/../etc/passwd"}) {
    SCOPED_TRACE(path);
    expect_refused(another().Get(path), 401);
    expect_refused(another().Get(std::string(path) + (std::strchr(path, '?') ? "&" : "?") + "token=" + server_.token()),
                   401);
  }
  expect_refused(another().Post("/frame", kFrame, "application/json"), 401);
  expect_refused(another().Post("/command", R"({"command":"stop"})", "application/json"), 401);
  httplib::Headers wrong = headers();
  wrong.find("X-Token")->second.back() ^= 1;
  expect_refused(another().Post("/command", wrong, R"({"command":"stop"})", "application/json"), 401);
  EXPECT_EQ(source_.frames, 0);
  EXPECT_TRUE(source_.commands.empty());
}

TEST_F(Server, OtherHostNamesAreRefused) {
  for (const char* host : {"evil.example", "evil.example:8080", "192.168.0.1:8080"}) {
    expect_refused(another().Get("/?token=" + server_.token(), {{"Host", host}}), 403);
    expect_refused(another().Get("/state", and_header("Host", host)), 403);
  }
  EXPECT_EQ(another().Get("/state", and_header("Host", "localhost:1"))->status, 200) << "a tunnel's port";
}

TEST_F(Server, OtherOriginsAreRefused) {
  for (const char* origin : {"http://evil.example", "null", "https://127.0.0.1"}) {
    expect_refused(another().Post("/command", and_header("Origin", origin), R"({"command":"stop"})", "text/plain"),
                   403);
  }
  EXPECT_TRUE(source_.commands.empty());
  const std::string own = "http://127.0.0.1:" + std::to_string(server_.port());
  EXPECT_EQ(another().Post("/command", and_header("Origin", own), R"({"command":"pause"})", "text/plain")->status, 200);
  EXPECT_EQ(source_.commands, std::vector<ViewCommand>{ViewCommand::kPause});
}

TEST_F(Server, NoAnswerIsForOtherSites) {
  for (const char* path : {"/state", "/cameras", "/nothing"}) {
    const httplib::Result result = another().Get(path, headers());
    ASSERT_TRUE(result) << path;
    EXPECT_FALSE(result->has_header("Access-Control-Allow-Origin")) << path;
    EXPECT_EQ(result->get_header_value("X-Content-Type-Options"), "nosniff") << path;
    EXPECT_EQ(result->get_header_value("Referrer-Policy"), "no-referrer") << path;
    EXPECT_EQ(result->get_header_value("Cache-Control"), "no-store") << path;
    EXPECT_EQ(result->get_header_value("Content-Security-Policy"), "default-src 'none'; frame-ancestors 'none'")
        << path;
  }
  const httplib::Result preflight = another().Options("/frame", {{"Origin", "http://evil.example"}});
  ASSERT_TRUE(preflight);
  EXPECT_NE(preflight->status, 200);
  EXPECT_FALSE(preflight->has_header("Access-Control-Allow-Origin"));
}

TEST_F(Server, ThePageRunsItsOwnScriptOnly) {
  const httplib::Result one = another().Get("/?token=" + server_.token());
  const httplib::Result two = another().Get("/?token=" + server_.token());
  ASSERT_TRUE(one && two);
  EXPECT_EQ(one->get_header_value_count("Content-Security-Policy"), 1u);
  const std::string policy = one->get_header_value("Content-Security-Policy");
  EXPECT_NE(policy, two->get_header_value("Content-Security-Policy")) << "a nonce serves once";
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
  for (const char* outside : {"http://", "https://", " src=", "@import", "url("}) {
    EXPECT_EQ(one->body.find(outside), std::string::npos) << outside << ": the page needs no other file";
  }
}

TEST_F(Server, FramesAreJpegsOfTheSize) {
  const httplib::Result result = post("/frame", kFrame);
  ASSERT_TRUE(result);
  ASSERT_EQ(result->status, 200) << result->body;
  EXPECT_EQ(result->get_header_value("Content-Type"), "image/jpeg");
  const json about = json::parse(result->get_header_value("X-Frame"));
  EXPECT_EQ(about["iteration"], 7);
  EXPECT_EQ(about["legend"], "red");
  const std::vector<unsigned char> bytes(result->body.begin(), result->body.end());
  const cv::Mat image = cv::imdecode(bytes, cv::IMREAD_COLOR);
  ASSERT_EQ(image.cols, 64);
  ASSERT_EQ(image.rows, 48);
  const cv::Vec3b bgr = image.at<cv::Vec3b>(20, 20);
  EXPECT_NEAR(bgr[2], 200, 3);
  EXPECT_NEAR(bgr[0], 0, 3);
}

TEST_F(Server, StateCamerasAndPhotographs) {
  EXPECT_EQ(json::parse(client_.Get("/cameras", headers())->body)["views"][0]["name"], "a.jpg");
  const json state = json::parse(client_.Get("/state?since=4", headers())->body);
  EXPECT_EQ(state["iteration"], 7);
  EXPECT_EQ(state["curve"][0][0], 5);
  const httplib::Result photograph = client_.Get("/photograph?view=0&width=32&height=32", headers());
  ASSERT_EQ(photograph->status, 200);
  EXPECT_EQ(photograph->get_header_value("Content-Type"), "image/jpeg");
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
    expect_refused(client_.Get(std::string("/photograph") + query, headers()), 400);
  }
  expect_refused(client_.Get("/state?since=x", headers()), 400);
  expect_refused(client_.Get("/etc/passwd", headers()), 404);
  EXPECT_EQ(source_.frames, 0);
  EXPECT_EQ(post("/frame", kFrame)->status, 200);
}

TEST_F(Server, BodiesAreLimited) {
  const std::string spaces(kMaxViewBody, ' ');
  expect_refused(another().Post("/frame", headers(), kFrame + spaces, "application/json"), 413);
  EXPECT_EQ(source_.frames, 0);
  EXPECT_EQ(post("/frame", kFrame)->status, 200);
}

TEST_F(Server, AnErrorOfTheRendererIsOneLine) {
  source_.fails = true;
  const httplib::Result result = post("/frame", kFrame);
  expect_refused(result, 500);
  EXPECT_EQ(result->body, "first line\n");
  source_.fails = false;
  EXPECT_EQ(post("/frame", kFrame)->status, 200);
}

TEST_F(Server, FourClientsAtOnce) {
  for (const char* name : {"a", "b", "c", "d"}) EXPECT_EQ(another().Get("/state", headers(name))->status, 200);
  expect_refused(another().Get("/state", headers("e")), 503);
  expect_refused(another().Post("/frame", headers("e"), kFrame, "application/json"), 503);
  EXPECT_EQ(another().Get("/state", headers("a"))->status, 200);
}

TEST_F(Server, OneFrameInWorkForEachClient) {
  source_.hold(true);
  std::thread first(
      [&] { EXPECT_EQ(another().Post("/frame", headers("a"), kFrame, "application/json")->status, 200); });
  while (source_.frames == 0) std::this_thread::yield();
  expect_refused(another().Post("/frame", headers("a"), kFrame, "application/json"), 503);
  EXPECT_EQ(source_.frames, 1);
  EXPECT_EQ(another().Get("/state", headers("a"))->status, 200) << "only frames wait";
  source_.hold(false);
  first.join();
  EXPECT_EQ(another().Post("/frame", headers("a"), kFrame, "application/json")->status, 200);
}

TEST_F(Server, SaysWhereThePageIs) {
  const std::string port = std::to_string(server_.port());
  EXPECT_EQ(server_.url(), "http://127.0.0.1:" + port + "/?token=" + server_.token());
  const std::string text = server_.instructions();
  EXPECT_NE(text.find(server_.url()), std::string::npos);
  EXPECT_NE(text.find("ssh -N -L " + port + ":127.0.0.1:" + port + " "), std::string::npos) << text;
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

TEST(ViewServer, EndsWhileAFrameWaits) {
  OneColor source;
  source.hold(true);
  std::thread asker;
  {
    ViewServerOptions options;
    options.port = 0;
    const ViewServer server(source, options);
    asker = std::thread([&, port = server.port(), token = server.token()] {
      httplib::Client("127.0.0.1", port).Post("/frame", {{"X-Token", token}}, kFrame, "application/json");
    });
    while (source.frames == 0) std::this_thread::yield();
  }
  asker.join();
}

}  // namespace
}  // namespace b3dgs
