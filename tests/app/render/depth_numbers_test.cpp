// b3dgs render --depth_format png16 and exr, --depth_kind and --normals: the files contain what was rendered.
#include "app/render/depth_images.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdlib>
#include <nlohmann/json.hpp>
#include <opencv2/imgcodecs.hpp>

#include "app/common/torch/model.h"
#include "model/cameras/cameras_json.h"
#include "model/raster_input.h"
#include "scene/images/image.h"
#include "support/files.h"
#include "support/run_program.h"
#include "support/temp_dir.h"

namespace b3dgs {
namespace {

using test::Outcome;
using test::run_b3dgs;

TEST(RenderedDepth, IsTheSameInFilesOfNumbers) {
  const test::TempDir folder;
  const auto run = [](const std::vector<std::string>& words) {
    const Outcome outcome = run_b3dgs(words);
    EXPECT_EQ(outcome.exit_code, 0) << outcome.err;
  };
  const std::string truth = (folder / "scene/truth.ply").string(), flight = (folder / "flight.json").string();
  run({"synth", "orbit", (folder / "scene").string(), "--points", "800", "--views", "3", "--quiet"});
  // The view is from above, where the scene covers a part of the image.
  test::write_bytes(flight, R"({"render_width": 64, "render_height": 48, "camera_path": [
      {"camera_to_world": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 5, 0, 0, 0, 1], "fov": 50},
      {"camera_to_world": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 9, 0, 0, 0, 1], "fov": 50}]})");
  for (const std::string format : {"exr", "png16"}) {
    run({"render", truth, "--cameras", flight, "--depth_format", format, "--no_alpha", "--output",
         (folder / format).string(), "--device", "cpu", "--quiet"});
  }
  ModelOptions options;
  options.model_path = truth;
  options.device = "cpu";
  const LoadedModel model = load_model(options);
  ModelRenderer renderer(model, torch::kCPU);
  const std::vector<NamedCamera> cameras = read_camera_file(flight).cameras;
  const double scale = nlohmann::json::parse(test::read_bytes(folder / "png16/depth.json")).at("scale");
  ::setenv("OPENCV_IO_ENABLE_OPENEXR", "1", 0);
  for (const std::size_t i : {0, 1}) {
    const RenderedView rendered = renderer.render(to_camera_view(cameras[i].camera));
    const std::vector<float> expected = mean_depths(rendered.depth, rendered.alpha);
    ASSERT_GT(*std::max_element(expected.begin(), expected.end()), 4);
    ASSERT_EQ(*std::min_element(expected.begin(), expected.end()), 0) << "nothing is seen in the corners";
    const std::string name = "0000" + std::to_string(i);
    const cv::Mat exr = cv::imread((folder / "exr/depth" / (name + ".exr")).string(), cv::IMREAD_UNCHANGED);
    ASSERT_EQ(exr.type(), CV_32FC1);
    ASSERT_EQ(exr.rows, 48);
    const Depth16 png = read_depth_map(folder / "png16/depth" / (name + ".png"));  // the reader of train --depths
    ASSERT_EQ(png.width, 64);
    for (int at = 0; at < 64 * 48; ++at) {
      const float depth = expected[static_cast<std::size_t>(at)];
      ASSERT_NEAR(exr.at<float>(at / 64, at % 64), depth, 1e-5 * depth);
      const int value = png.pixels[static_cast<std::size_t>(at)];
      if (depth == 0) {
        ASSERT_EQ(value, 0);
      } else if (value < 65535) {
        ASSERT_NEAR(scale / depth, value, 0.5 + 1e-5 * value) << "rounded to the nearest";
      } else {
        ASSERT_LE(depth, scale / 65534);
      }
    }
  }
  EXPECT_FALSE(std::filesystem::exists(folder / "exr/depth.json"));
}

TEST(RenderedSurface, IsThatOfTheRasterizer) {
  const test::TempDir folder;
  const auto run = [](const std::vector<std::string>& words) { return run_b3dgs(words); };
  const std::string truth = (folder / "scene/truth.ply").string(), above = (folder / "above.json").string();
  ASSERT_EQ(run({"synth", "orbit", (folder / "scene").string(), "--views", "3", "--quiet"}).exit_code, 0);
  test::write_bytes(above, R"({"render_width": 64, "render_height": 48, "camera_path": [
      {"camera_to_world": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 9, 0, 0, 0, 1], "fov": 50}]})");
  const auto render = [&](std::vector<std::string> more) {
    more.insert(more.begin(), {"render", truth, "--cameras", above, "--device", "cpu", "--quiet"});
    return run(more);
  };
  const Outcome rendered =
      render({"--depth_format", "exr", "--depth_kind", "surface", "--normals", "--output", (folder / "out").string()});
  ASSERT_EQ(rendered.exit_code, 0) << rendered.err;

  ModelOptions options;
  options.model_path = truth;
  options.device = "cpu";
  const LoadedModel model = load_model(options);
  ModelRenderer renderer(model, torch::kCPU);
  renderer.render(to_camera_view(read_camera_file(above).cameras[0].camera));
  const SurfaceView expected = renderer.rasterizer.geometry(renderer.gaussians);
  ::setenv("OPENCV_IO_ENABLE_OPENEXR", "1", 0);
  const cv::Mat exr = cv::imread((folder / "out/depth/00000.exr").string(), cv::IMREAD_UNCHANGED);
  const Image8 normals = read_image(folder / "out/normals/00000.png", false);
  ASSERT_EQ(exr.type(), CV_32FC1);
  ASSERT_EQ(normals.width, 64);
  const torch::Tensor colors =
      (127.5 * (1 + expected.normal * torch::tensor({1.0f, -1.0f, -1.0f}))) * (expected.depth > 0).unsqueeze(2);
  int n_blue = 0, n_black = 0;
  for (int at = 0; at < 64 * 48; ++at) {
    ASSERT_EQ(exr.at<float>(at / 64, at % 64), expected.depth.flatten()[at].item<float>());
    const std::uint8_t* const pixel = normals.pixels.data() + static_cast<std::size_t>(3 * at);
    for (int c = 0; c < 3; ++c) ASSERT_NEAR(pixel[c], colors.view({-1, 3})[at][c].item<float>(), 0.51);
    n_blue += pixel[2] > 250 ? 1 : 0;
    n_black += pixel[2] == 0 ? 1 : 0;
  }
  EXPECT_GT(n_blue, 64 * 48 / 10) << "the ground faces the camera";
  EXPECT_GT(n_black, 64 * 48 / 10) << "nothing is seen in the corners";

  ASSERT_EQ(render({"--output", (folder / "mean").string()}).exit_code, 0);
  EXPECT_FALSE(std::filesystem::exists(folder / "mean/normals"));
  const Outcome refused = render({"--normals", "--video", (folder / "v.mp4").string()});
  EXPECT_EQ(refused.exit_code, 2);
  EXPECT_NE(refused.err.find("--normals is for images"), std::string::npos) << refused.err;
}

TEST(InverseDepth, CountsPixelsThatAreTooNear) {
  const InverseDepth16 inverse = inverse_depth_16({0, 0.5f, 1, 2, 1e9f, 65535}, {3, 2}, 65535);
  EXPECT_EQ(inverse.map.pixels, (std::vector<std::uint16_t>{0, 65535, 65535, 32768, 0, 1}));
  EXPECT_EQ(inverse.n_too_near, 1);
}

}  // namespace
}  // namespace b3dgs
