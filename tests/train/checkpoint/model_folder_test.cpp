// Tests model folders, image metrics, and conversions of Gaussians.

#include "model/model_folder.h"
#include "config/train_options.h"

#include <gtest/gtest.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "core/check.h"
#include "model/cameras/cameras_json.h"
#include "model/formats/splat_formats.h"
#include "support/approx.h"
#include "support/expect_error.h"
#include "support/files.h"
#include "support/temp_dir.h"
#include "support/train/tiny_scene.h"
#include "train/gaussians/gaussian_model.h"

namespace b3dgs {
namespace {

using nlohmann::json;

TEST(ModelFolder, WritesWhatTheOriginalsToolsRead) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  const ModelFolder folder(temp.path());
  TrainConfig config;
  config.source_path = "/data/it's";
  config.model_path = "/out";
  config.eval = true;
  folder.write_inputs(config, scene);

  EXPECT_EQ(read_point_ply(temp / "input.ply").size(), 120);
  EXPECT_EQ(test::read_bytes(temp / "cfg_args"),
            "Namespace(sh_degree=3, source_path='/data/it\\'s', model_path='/out', images='images', depths='', "
            "resolution=-1, white_background=False, train_test_exp=False, data_device='cpu', eval=True)");
  EXPECT_TRUE(config_differences(config, folder.read_config()).empty());

  const json cameras = json::parse(test::read_bytes(temp / "cameras.json"));
  ASSERT_EQ(cameras.size(), 8u);
  EXPECT_EQ(cameras[0]["img_name"], "view0.png") << "test views come first";
  EXPECT_EQ(cameras[1]["img_name"], "view4.png");
  EXPECT_EQ(cameras[2]["img_name"], "view1.png");
  EXPECT_EQ(cameras[5]["id"], 5);
  EXPECT_EQ(cameras[0]["width"], 60);
  // View 0 is at (3, -1, 0) and looks along (-3, 1, 0), which is the last column of camera-to-world.
  EXPECT_NEAR(cameras[0]["position"][0], 3, 1e-12);
  EXPECT_NEAR(cameras[0]["position"][1], -1, 1e-12);
  EXPECT_NEAR(cameras[0]["rotation"][0][2], -3 / std::sqrt(10.0), 1e-12);
  EXPECT_NEAR(cameras[0]["rotation"][1][2], 1 / std::sqrt(10.0), 1e-12);
}

TEST(ModelFolder, ReadsItsCamerasBack) {
  Scene scene = test::make_tiny_scene();
  scene.train[0].camera.cx += 3.25;  // not part of the original's cameras.json
  const test::TempDir temp;
  const ModelFolder folder(temp.path());
  folder.write_inputs({}, scene);
  const std::vector<NamedCamera> cameras = read_cameras_json(folder.cameras());
  ASSERT_EQ(cameras.size(), 8u);
  EXPECT_EQ(cameras[2].name, "view1.png");
  const Camera &read = cameras[2].camera, &written = scene.train[0].camera;
  EXPECT_EQ(read.width, written.width);
  EXPECT_EQ(read.fy, written.fy);
  EXPECT_EQ(read.cx, written.cx);
  for (std::size_t i = 0; i < 9; ++i) {
    EXPECT_EQ(read.cam_from_world.rotation[i], written.cam_from_world.rotation[i]);
  }
  for (std::size_t i = 0; i < 3; ++i) {
    EXPECT_NEAR(read.cam_from_world.translation[i], written.cam_from_world.translation[i], 1e-12);
  }
}

TEST(ModelFolder, ReadsTheOriginalsCamerasAndRefusesWrongOnes) {
  const test::TempDir temp;
  const auto write = [&](const std::string& more) {
    test::write_bytes(temp / "cameras.json",
                      R"([{"id": 0, "img_name": "a", "width": 60, "height": 40, "fx": 50, "fy": 51, )" + more + "}]");
  };
  const std::string pose = R"("position": [1, 2, 3], "rotation": [[1, 0, 0], [0, 0, 1], [0, -1, 0]])";
  write(pose);
  const Camera camera = read_cameras_json(temp / "cameras.json").at(0).camera;
  EXPECT_EQ(camera.cx, 30);
  EXPECT_EQ(camera.cy, 20);
  EXPECT_EQ(camera.center(), (std::array<double, 3>{1, 2, 3}));

  const auto read = [&] { read_cameras_json(temp / "cameras.json"); };
  write(R"("position": [1, 2, 3])");
  EXPECT_TRUE(test::fails_with<InputError>({"camera 0", "rotation[3][3]"}, read));
  write(R"("position": [1, 2, 3], "rotation": [[2, 0, 0], [0, 1, 0], [0, 0, 1]])");
  EXPECT_TRUE(test::fails_with<InputError>({"camera 0 (a)", "rotation"}, read));
  write(R"("position": [1, 2, 1e300], "rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]])");
  EXPECT_TRUE(test::fails_with<InputError>({"camera 0 (a)", "impossible position"}, read));
  test::write_bytes(temp / "cameras.json", R"([{"img_name": "a", "width": 4294967297, "height": 1}])");
  EXPECT_TRUE(test::fails_with<InputError>({"camera 0", "width", "4294967297"}, read));
  test::write_bytes(temp / "cameras.json", "{}");
  EXPECT_TRUE(test::fails_with<InputError>({"cameras.json", "list of cameras"}, read));
  EXPECT_TRUE(
      test::fails_with<InputError>({"none.json", "cannot be opened"}, [&] { read_cameras_json(temp / "none.json"); }));
}

TEST(ModelFolder, AddsResultsByIteration) {
  const test::TempDir temp;
  const ModelFolder folder(temp.path());
  const EvaluationSource source{"/data/scene", "images_2", 4, 640, 480, "test"};
  EXPECT_EQ(folder.results_key(7000), "ours_7000");
  folder.write_results("ours_7000", {{{"a/1.jpg", {20, 0.5}}, {"b.jpg", {30, 0.75, 0.7}}}, {25, 0.625, 0.8}}, source);
  folder.write_results("ours_30000", {{{"a/1.jpg", {40, 1}}}, {40, 1}}, source);
  const json results = json::parse(test::read_bytes(temp / "results.json"));
  EXPECT_EQ(results.size(), 2u);
  EXPECT_EQ(
      results["ours_7000"],
      json::parse(
          R"({"SSIM": 0.625, "PSNR": 25.0, "sharpness": 0.8, "views": 2, "split": "test", "width": 640, "height": 480,
                            "resolution": 4, "images": "images_2", "source_path": "/data/scene"})"));
  EXPECT_EQ(results["ours_30000"]["PSNR"], 40);
  const json per_view = json::parse(test::read_bytes(temp / "per_view.json"));
  EXPECT_EQ(per_view["ours_7000"]["PSNR"]["a/1.jpg"], 20);
  EXPECT_EQ(per_view["ours_7000"]["SSIM"]["b.jpg"], 0.75);
  EXPECT_EQ(per_view["ours_7000"]["sharpness"]["b.jpg"], 0.7);
  test::write_bytes(temp / "results.json", "{\"ours_7000\": ");
  folder.write_results("ours_5", {{}, {10, 0.1}}, source);
  EXPECT_EQ(json::parse(test::read_bytes(temp / "results.json")).size(), 1u) << "a damaged file is replaced";
}

TEST(ModelFolder, WritesLpipsWithItsNetwork) {
  const test::TempDir temp;
  const ModelFolder folder(temp.path());
  Evaluation evaluation{{{"a.jpg", {20, 0.5, 0.9, {}, 0.25}}, {"b.jpg", {30, 0.75, 0.9, {}, 0.75}}},
                        {25, 0.625, 0.9, {}, 0.5},
                        false,
                        "vgg.pt"};
  folder.write_results("ours_7000", evaluation, {"/data/scene", "images_2", 4, 640, 480, "test"});
  const json results = json::parse(test::read_bytes(temp / "results.json"));
  EXPECT_EQ(results["ours_7000"]["LPIPS"], 0.5);
  EXPECT_EQ(results["ours_7000"]["lpips_network"], "vgg.pt");
  EXPECT_EQ(json::parse(test::read_bytes(temp / "per_view.json"))["ours_7000"]["LPIPS"]["b.jpg"], 0.75);
}

TEST(ModelFolder, ResultsOfAnotherSourceHaveAnotherKey) {
  const test::TempDir temp;
  const ModelFolder folder(temp.path());
  const EvaluationSource first{"/data/scene", "images", 4, 320, 240, "test"};
  EvaluationSource second = first;
  second.source_path = "/elsewhere/scene";
  EXPECT_EQ(folder.results_key(10, "r4", first), "ours_10_r4");
  folder.write_results("ours_10_r4", {{}, {10, 0.1}}, first);
  EXPECT_EQ(folder.results_key(10, "r4", first), "ours_10_r4") << "measured again";
  EXPECT_EQ(folder.results_key(10, "r4", second), "ours_10_r4_2");
  folder.write_results("ours_10_r4_2", {{}, {20, 0.2}}, second);
  EXPECT_EQ(folder.results_key(10, "r4", second), "ours_10_r4_2");
  EXPECT_EQ(folder.results_key(10), "ours_10");
  const json results = json::parse(test::read_bytes(temp / "results.json"));
  EXPECT_EQ(results["ours_10_r4"]["PSNR"], 10);
  EXPECT_EQ(results["ours_10_r4_2"]["source_path"], "/elsewhere/scene");
}

TEST(ModelFolder, ListsIterationsByNumber) {
  const test::TempDir temp;
  const ModelFolder folder(temp.path());
  EXPECT_TRUE(folder.ply_iterations().empty());
  EXPECT_TRUE(folder.checkpoint_iterations().empty());
  for (const int iteration : {30000, 500, 7000}) {
    test::write_bytes(folder.ply(iteration), "");
    test::write_bytes(folder.checkpoint(iteration), "");
  }
  test::write_bytes(temp / "point_cloud/iteration_9/other.ply", "");
  test::write_bytes(temp / "point_cloud/iteration_x/point_cloud.ply", "");
  test::write_bytes(temp / "checkpoints/iteration_8.b3dgs.tmp", "");
  EXPECT_EQ(folder.ply_iterations(), (std::vector<int>{500, 7000, 30000}));
  EXPECT_EQ(folder.checkpoint_iterations(), (std::vector<int>{500, 7000, 30000}));
}

TEST(ModelFolder, RefusesADamagedConfig) {
  const test::TempDir temp;
  const ModelFolder folder(temp.path());
  EXPECT_TRUE(test::fails_with<InputError>({"config.json", "cannot be opened"}, [&] { folder.read_config(); }));
  test::write_bytes(temp / "config.json", "{\"iterations\": 1");
  EXPECT_TRUE(test::fails_with<InputError>({"config.json", "JSON"}, [&] { folder.read_config(); }));
  test::write_bytes(temp / "config.json", "{\"iterationen\": 1}");
  EXPECT_TRUE(test::fails_with<InputError>({"config.json", "iterationen"}, [&] { folder.read_config(); }));
}

TEST(Metrics, PsnrIsThatOfTheMeanSquaredError) {
  Image8 truth(4, 2, 3);
  torch::Tensor rendered = torch::zeros({2, 4, 3});
  EXPECT_EQ(image_quality(rendered, truth, nullptr)->psnr, 100);
  EXPECT_NEAR(image_quality(rendered, truth, nullptr)->ssim, 1, 1e-6);
  rendered[1][2][0] = 51.0f / 255.0f;  // 0.2 in one of 24 values
  EXPECT_NEAR(image_quality(rendered, truth, nullptr)->psnr, -10 * std::log10(0.04 / 24), 1e-9);
  rendered[1][2][0] = -7.0f;  // is clamped before the comparison
  EXPECT_EQ(image_quality(rendered, truth, nullptr)->psnr, 100);
}

TEST(Metrics, IgnoreInvalidPixels) {
  Image8 truth(4, 2, 3), valid(4, 2, 1);
  torch::Tensor rendered = torch::zeros({2, 4, 3});
  rendered[0][0].fill_(1);
  rendered[1][3][1] = 51.0f / 255.0f;
  valid.pixels = {0, 255, 255, 0, 255, 255, 0, 255};  // 5 of 8 are valid, but not the first
  EXPECT_NEAR(image_quality(rendered, truth, &valid)->psnr, -10 * std::log10(0.04 / 15), 1e-9);
}

TEST(Metrics, SharpnessIsTheRatioOfLaplacians) {
  // A photograph with one bright pixel in black: its own Laplacian is 4 x 300, and that of each neighbour 300, but only
  // two of these are inside the border of the 5 x 4 px.
  Image8 truth(5, 4, 3), valid(5, 4, 1);
  torch::Tensor rendered = torch::zeros({4, 5, 3});
  EXPECT_EQ(image_quality(rendered, truth, nullptr)->sharpness, 1) << "nothing to compare";
  std::fill_n(truth.pixels.begin() + static_cast<std::ptrdiff_t>(3 * (1 * 5 + 1)), 3, std::uint8_t{100});
  EXPECT_EQ(image_quality(rendered, truth, nullptr)->sharpness, 0) << "a flat render";
  rendered[1][1].fill_(100.0f / 255.0f);
  EXPECT_EQ(image_quality(rendered, truth, nullptr)->sharpness, 1);
  rendered[1][1].fill_(50.0f / 255.0f);
  EXPECT_EQ(image_quality(rendered, truth, nullptr)->sharpness, 0.5);
  rendered[2][3].fill_(50.0f / 255.0f);  // the same at another place, where one neighbour is on each border
  EXPECT_EQ(image_quality(rendered, truth, nullptr)->sharpness, 1);
  std::fill(valid.pixels.begin(), valid.pixels.end(), std::uint8_t{255});
  valid.pixels[3 * 5 + 3] = 0;  // its neighbour (2, 3) is not compared then, but (2, 2) still is
  const double photograph = 4 + 1 + 1, first = 0.5 * photograph, second = 0.5 * (1 + 1);
  EXPECT_DOUBLE_EQ(image_quality(rendered, truth, &valid)->sharpness, (first + second) / photograph);
}

TEST(Metrics, OfNoPixelAreNone) {
  const Image8 truth(4, 2, 3), none(4, 2, 1);
  EXPECT_FALSE(image_quality(torch::zeros({2, 4, 3}), truth, &none).has_value());
}

TEST(ModelFolder, NamesViewsWithoutValidPixelsInTheResults) {
  const test::TempDir temp;
  const ModelFolder folder(temp.path());
  Evaluation evaluation;
  evaluation.views = {{"a.png", {30, 0.9}}};
  evaluation.unmeasured = {"b.png"};
  evaluation.mean = {30, 0.9};
  folder.write_results("ours_7", evaluation, {});
  const nlohmann::json results = nlohmann::json::parse(test::read_bytes(temp / "results.json"));
  EXPECT_EQ(results.at("ours_7").at("views"), 1);
  EXPECT_EQ(results.at("ours_7").at("views_without_pixels"), (std::vector<std::string>{"b.png"}));
}

TEST(Metrics, RoundToEightBits) {
  const Image8 image = to_image8(torch::tensor({{-1.0f, 0.0f, 0.4f / 255, 0.6f / 255, 1.0f, 2.0f, NAN}}));
  EXPECT_EQ(image.pixels, (std::vector<std::uint8_t>{0, 0, 0, 1, 255, 255, 0}));
  EXPECT_EQ(image.channels, 1);
}

TEST(Metrics, BytesAreThoseOfLround) {
  // Tests values around each rounding threshold, and where 255 x is exactly k + 0.5.
  std::vector<float> values{-1e30f, -0.0f, 1e-40f, INFINITY, -INFINITY, NAN, std::nextafter(1.0f, 0.0f), 1.5f};
  for (int k = 0; k < 256; ++k) {
    float value = (static_cast<float>(k) + 0.5f) / 255.0f;
    for (int step = 0; step < 4; ++step) value = std::nextafter(value, 0.0f);
    for (int step = 0; step < 9; ++step, value = std::nextafter(value, 2.0f)) values.push_back(value);
    values.push_back(static_cast<float>(k) / 255.0f);
  }
  values.resize(values.size() / 12 * 12);
  std::vector<std::uint8_t> expected;
  bool has_half = false;
  for (const float value : values) {
    const float scaled = value > 0.0f ? 255.0f * std::min(value, 1.0f) : 0.0f;
    has_half = has_half || scaled - std::floor(scaled) == 0.5f;
    expected.push_back(static_cast<std::uint8_t>(std::lround(scaled)));
  }
  EXPECT_TRUE(has_half);
  const torch::Tensor image = torch::tensor(values).view({-1, 4, 3});
  EXPECT_EQ(to_image8(image).pixels, expected);
  EXPECT_TRUE(image.view({-1}).slice(0, 0, 5).equal(torch::tensor(values).slice(0, 0, 5))) << "the image is unchanged";
  const torch::Tensor transposed = image.select(2, 0).t();
  EXPECT_EQ(to_image8(transposed).pixels, to_image8(transposed.contiguous()).pixels);
}

TEST(GaussianModel, StartsFromPointsAsTheOriginalDoes) {
  PointCloud points;
  points.positions = {0, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0, 3};
  points.colors = {255, 0, 128, 0, 0, 0, 0, 0, 0, 0, 0, 0};
  const SplatCloud cloud = splats_from_points(points, 2);
  // The squared distances from the first point to the others are 1, 4 and 9.
  EXPECT_NEAR(cloud.log_scales[0], 0.5 * std::log(14.0 / 3.0), 1e-6);
  EXPECT_EQ(cloud.log_scales[0], cloud.log_scales[2]);
  EXPECT_NEAR(cloud.logit_opacities[3], std::log(0.1 / 0.9), 1e-6);
  EXPECT_NEAR(0.5 + 0.28209479177387814 * cloud.sh0[0], 1.0, 1e-6);
  EXPECT_NEAR(0.5 + 0.28209479177387814 * cloud.sh0[2], 128 / 255.0, 1e-6);
  EXPECT_EQ(cloud.quats[4], 1);
  EXPECT_EQ(cloud.quats[5], 0);
  EXPECT_EQ(cloud.shN, std::vector<float>(4 * 8 * 3, 0.0f));
}

TEST(GaussianModel, StartsWithTheOpacityAndScaleOfTheOptions) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config;
  const SplatCloud usual = initial_splats(config, scene);
  config.init_opacity = 0.5;
  config.init_scale = 0.1;
  const SplatCloud other = initial_splats(config, scene);
  EXPECT_EQ(other.logit_opacities, std::vector<float>(usual.logit_opacities.size(), 0.0f));
  for (std::size_t i = 0; i < usual.log_scales.size(); ++i) {
    EXPECT_NEAR(other.log_scales[i], usual.log_scales[i] + std::log(0.1), 1e-6);
  }
  write_splat_ply(temp / "splats.ply", usual);
  config.init_ply = (temp / "splats.ply").string();
  EXPECT_EQ(initial_splats(config, scene).logit_opacities, usual.logit_opacities) << "a model stays as it is";
  EXPECT_EQ(initial_splats(config, scene).log_scales, usual.log_scales);
}

TEST(GaussianModel, TensorsHaveTheValuesOfTheCloud) {
  SplatCloud cloud = splats_from_points(test::make_tiny_scene().points, 2);
  for (std::size_t i = 0; i < cloud.shN.size(); ++i) cloud.shN[i] = static_cast<float>(i);
  const GaussianTensors same = to_tensors(cloud, 2, torch::kCPU);
  EXPECT_EQ(sh_degree_of(same), 2);
  EXPECT_TRUE(test::same(same.shN, torch::tensor(cloud.shN).view_as(same.shN)));
  EXPECT_TRUE(test::same(same.means, torch::tensor(cloud.means).view({-1, 3})));
  const GaussianTensors more = to_tensors(cloud, 3, torch::kCPU), less = to_tensors(cloud, 1, torch::kCPU);
  EXPECT_TRUE(test::same(more.shN.slice(1, 0, 8), same.shN));
  EXPECT_EQ(more.shN.slice(1, 8).abs().max().item<float>(), 0);
  EXPECT_TRUE(test::same(less.shN, same.shN.slice(1, 0, 3)));
}

}  // namespace
}  // namespace b3dgs
