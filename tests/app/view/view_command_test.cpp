// The commands of the live view: b3dgs view and b3dgs train --view.
#include <gtest/gtest.h>

#include <cmath>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <thread>

#include "app/common/commands.h"
#include "app/common/torch/model.h"
#include "app/view/view_options.h"
#include "app/view/view_server.h"
#include "app/view/watched_scene.h"
#include "dist/control/socket.h"
#include "scene/images/image.h"
#include "support/expect_error.h"
#include "support/http_client.h"
#include "support/run_program.h"
#include "support/temp_dir.h"
#include "train/device.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using test::fails_with;
using Words = std::vector<std::string>;

/// Trains a model for a few iterations.
class ViewPrograms : public ::testing::Test {
 protected:
  void SetUp() override {
    ASSERT_EQ(run_synth({"orbit", scene(), "--points", "1500", "--views", "12", "--width", "160", "--height", "120",
                         "--quiet"}),
              0);
    ASSERT_EQ(run_train({scene(), "-m", model(), "--iterations", "30", "--quiet", "--device", "cpu"}), 0);
  }
  std::string scene() const { return (folder_.path() / "scene").string(); }
  std::string model() const { return (folder_.path() / "model").string(); }

  test::TempDir folder_;
};

/// Returns a port on which nobody listens.
int free_port() {
  const int port = port_of(listen_at("127.0.0.1", 0));
  return port;
}

double psnr(const cv::Mat& bgr, const Image8& rgb) {
  EXPECT_EQ(bgr.cols, rgb.width);
  EXPECT_EQ(bgr.rows, rgb.height);
  double squares = 0;
  for (int y = 0; y < rgb.height; ++y) {
    for (int x = 0; x < rgb.width; ++x) {
      for (int c = 0; c < 3; ++c) {
        const double d = bgr.at<cv::Vec3b>(y, x)[2 - c] -
                         double{rgb.pixels[static_cast<std::size_t>(3 * (y * rgb.width + x) + c)] * 1.0};
        squares += d * d;
      }
    }
  }
  return 10 * std::log10(255.0 * 255.0 * static_cast<double>(rgb.pixels.size()) / squares);
}

TEST_F(ViewPrograms, AFrameIsWhatRenderWrites) {
  const fs::path images = folder_.path() / "images";
  ASSERT_EQ(run_render({model(), "--path", "train", "--output", images.string(), "--quiet", "--device", "cpu"}), 0);

  ModelOptions options;
  options.model_path = model();
  options.device = "cpu";
  StatusLine status = StatusLine::silent();
  LoadedModel loaded = load_model(options);
  add_scene(loaded, status);
  ModelRenderer renderer(loaded, torch::kCPU);
  WatchedModel watched({renderer.gaussians, renderer.settings, loaded.iteration}, loaded.scene,
                       viewed_scene(loaded.scene, loaded.splats.means, "model"));
  ViewServerOptions any;
  any.port = 0;
  const ViewServer server(watched, any);
  std::atomic<int> stop{0};
  std::thread viewer([&] {
    const test::HttpClient client(server.port());
    const auto frame = [&](const std::string& mode) {
      const std::optional<test::HttpAnswer> result =
          client.post("/frame", {{"X-Token", server.token()}},
                      R"({"width":160,"height":120,"view":2,"quality":95,"mode":")" + mode + "\"}");
      EXPECT_TRUE(result && result->status == 200) << mode << ": " << (result ? result->body : "no answer");
      if (!result || result->status != 200) return cv::Mat();
      return cv::imdecode(std::vector<unsigned char>(result->body.begin(), result->body.end()), cv::IMREAD_COLOR);
    };
    const cv::Mat color = frame("render");
    if (!color.empty()) {
      EXPECT_GT(psnr(color, read_image(images / "renders" / "00002.png", false)), 35);
    }
    const cv::Mat alpha = frame("alpha");
    if (!alpha.empty()) {
      EXPECT_GT(psnr(alpha, read_image(images / "alpha" / "00002.png", false)), 35);
    }
    for (const char* mode : {"depth", "difference", "load"}) {
      const cv::Mat image = frame(mode);
      if (image.empty()) continue;
      cv::Scalar mean, spread;
      cv::meanStdDev(image, mean, spread);
      EXPECT_GT(spread[0] + spread[1] + spread[2], 10) << mode << " shows something";
    }
    stop = 1;
  });
  watched.run(stop);
  viewer.join();
}

TEST_F(ViewPrograms, APickIsThePointThatTheViewShowsThere) {
  ModelOptions options;
  options.model_path = model();
  options.device = "cpu";
  StatusLine status = StatusLine::silent();
  LoadedModel loaded = load_model(options);
  add_scene(loaded, status);
  ModelRenderer renderer(loaded, torch::kCPU);
  WatchedModel watched({renderer.gaussians, renderer.settings, loaded.iteration}, loaded.scene,
                       viewed_scene(loaded.scene, loaded.splats.means, "model"));
  ASSERT_TRUE(watched.scene().up);
  EXPECT_GT((*watched.scene().up)[2], 0.99) << "the cameras are on a ring about the z axis";
  std::atomic<int> stop{0};
  std::thread viewer([&] {
    int n_points = 0;
    for (const auto& place : {std::array<double, 2>{0.5, 0.5}, {0.3, 0.7}, {0.8, 0.9}}) {
      FrameRequest request;
      request.view = 2;
      request.camera = watched.scene().views[2].camera;
      request.pick = place;
      const auto point = watched.render(request).point;
      if (!point) continue;
      ++n_points;
      const auto local = watched.scene().frame.from_world(point->data());
      const auto seen = request.camera.project(local.data());
      EXPECT_TRUE(seen);
      if (!seen) continue;
      EXPECT_NEAR(seen->x, place[0] * request.camera.width, 1e-3);
      EXPECT_NEAR(seen->y, place[1] * request.camera.height, 1e-3);
      EXPECT_LT(distance(*point, {0, 0, 0}), 20) << "within the scene";
    }
    EXPECT_GT(n_points, 0);
    stop = 1;
  });
  watched.run(stop);
  viewer.join();
}

TEST_F(ViewPrograms, ShowsAFileOfGaussiansWithoutAScene) {
  const int port = free_port();
  test::RunOptions options;
  options.signal_when = [&] {
    const std::optional<test::HttpAnswer> answer = test::HttpClient(port).get("/");
    return answer && answer->status == 401;
  };
  options.signal = SIGINT;
  const fs::path ply = folder_.path() / "splats.ply";  // not in the model folder, whose cameras would be found
  fs::copy_file(fs::path(model()) / "point_cloud" / "iteration_30" / "point_cloud.ply", ply);
  const test::Outcome viewed =
      test::run_b3dgs({"view", ply.string(), "--view", std::to_string(port), "--device", "cpu"}, options);
  EXPECT_EQ(viewed.exit_code, 0) << viewed.err;
  EXPECT_NE(viewed.out.find("0 cameras"), std::string::npos) << viewed.out;
  EXPECT_NE(viewed.out.find("/?token="), std::string::npos) << viewed.out;
  EXPECT_NE(viewed.out.find("ssh -N -L "), std::string::npos) << viewed.out;
}

TEST_F(ViewPrograms, ATrainingThatIsShownEndsByItself) {
  const test::Outcome trained = test::run_b3dgs(
      {"train", "--view", "0", scene(), "-m", (folder_.path() / "shown").string(), "--iterations", "20"});
  EXPECT_EQ(trained.exit_code, 0) << trained.err;
  EXPECT_NE(trained.out.find("http://127.0.0.1:"), std::string::npos) << trained.out;
  EXPECT_EQ(trained.err.find("warning"), std::string::npos) << trained.err;
}

TEST_F(ViewPrograms, AnotherAddressIsWarnedOf) {
  const test::Outcome trained = test::run_b3dgs(
      {"train", "--view", "0.0.0.0:0", scene(), "-m", (folder_.path() / "open").string(), "--iterations", "20"});
  EXPECT_EQ(trained.exit_code, 0) << trained.err;
  EXPECT_NE(trained.err.find("other machines can reach the page"), std::string::npos) << trained.err;
}

TEST_F(ViewPrograms, ATakenPortIsAnErrorBeforeTraining) {
  const Socket other = listen_at("127.0.0.1", 0);
  const int port = port_of(other);
  const std::string folder = (folder_.path() / "taken").string();
  EXPECT_TRUE(fails_with<InputError>({"port " + std::to_string(port), "taken"}, [&] {
    run_train({scene(), "-m", folder, "--quiet", "--device", "cpu", "--view", std::to_string(port)});
  }));
  EXPECT_FALSE(fs::exists(folder));
}

TEST_F(ViewPrograms, OptionsThatDoNotGoTogether) {
  EXPECT_TRUE(fails_with<InputError>({"--view", "several ranks"}, [&] {
    run_train({scene(), "--view", "--ranks", "2", "--device", "cpu"});
  }));
  EXPECT_TRUE(fails_with<InputError>({"--view 70000"}, [&] { run_train({scene(), "--view", "70000"}); }));
  EXPECT_TRUE(fails_with<InputError>({"not found"}, [&] { run_view({(folder_.path() / "none").string()}); }));
}

TEST(ViewOptions, APlaceMayFollowTheOption) {
  EXPECT_EQ(join_view_place({"--view", "8080", "scene"}), (Words{"--view=8080", "scene"}));
  EXPECT_EQ(join_view_place({"--view", "[::1]:80", "scene"}), (Words{"--view=[::1]:80", "scene"}));
  EXPECT_EQ(join_view_place({"--view", "scene"}), (Words{"--view=auto", "scene"}));
  EXPECT_EQ(join_view_place({"--view", "host:80"}), (Words{"--view=auto", "host:80"})) << "a folder";
  EXPECT_EQ(join_view_place({"--view", "localhost:auto", "x"}), (Words{"--view=localhost:auto", "x"}));
  EXPECT_EQ(join_view_place({"--view", ":80"}), (Words{"--view=auto", ":80"}));
  EXPECT_EQ(join_view_place({"scene", "--view"}), (Words{"scene", "--view=auto"}));
  EXPECT_EQ(join_view_place({"-r", "4", "--view", "-m", "2"}), (Words{"-r", "4", "--view=auto", "-m", "2"}));
}

TEST(ViewOptions, APlaceOfAnyLengthIsReadOrRefused) {
  for (const std::string& before : {std::string(), std::string("1.2:"), std::string(200000, 'a') + ":"}) {
    const std::string place = before + std::string(200000, '1');
    EXPECT_EQ(join_view_place({"--view", place}), (Words{"--view=" + place}));
    EXPECT_TRUE(fails_with<InputError>({"not a place for the page"}, [&] { parse_view_place(place); }));
  }
}

TEST(ViewOptions, APlaceIsAPortOrAnAddressAndAPort) {
  EXPECT_EQ(parse_view_place("auto").port, std::nullopt);
  EXPECT_EQ(parse_view_place("::1:auto").address, "::1");
  EXPECT_EQ(parse_view_place("8080").port, 8080);
  EXPECT_EQ(parse_view_place("8080").address, ViewServerOptions{}.address);
  EXPECT_EQ(parse_view_place("0.0.0.0:0").port, 0);
  EXPECT_EQ(parse_view_place("0.0.0.0:0").address, "0.0.0.0");
  EXPECT_EQ(parse_view_place("[::1]:80").address, "::1");
  for (const char* place : {"", "-1", "65536", "8080x", "127.0.0.1:", ":8080", "127.0.0.1"}) {
    EXPECT_TRUE(fails_with<InputError>({"PORT or ADDRESS:PORT"}, [&] { parse_view_place(place); })) << place;
  }
}

}  // namespace
}  // namespace b3dgs
