// Tests that depth priors improve depths, and exact resume.
#include <gtest/gtest.h>

#include "model/formats/splat_formats.h"
#include "support/files.h"
#include "support/same.h"
#include "support/temp_dir.h"
#include "support/train/depth_maps.h"
#include "support/train/disk_scene.h"
#include "support/train/training.h"

namespace b3dgs {
namespace {

using test::train;
using test::Trained;

/// Returns the mean error of the inverse depth over the pixels of the views.
double depth_error(const Trained& run, const std::vector<View>& views, const GaussianTensors& truth) {
  const GaussianTensors model = to_tensors(read_splat_ply(run.result.ply), 0, torch::kCPU);
  double sum = 0;
  for (const View& view : views) {
    sum +=
        (test::inverse_depth(model, view.camera) - test::inverse_depth(truth, view.camera)).abs().mean().item<double>();
  }
  return sum / static_cast<double>(views.size());
}

TEST(DepthTraining, DepthsBecomeBetter) {
  const test::TempDir temp;
  test::TinySceneOptions options;
  options.n_gaussians = 60;
  GaussianTensors truth;
  Scene scene = test::make_tiny_scene(options, &truth);
  TrainConfig config;
  config.init_ply = (temp / "start.ply").string();  // a file, because the scene's points are on the surfaces
  write_point_ply(config.init_ply, scene.points);
  test::add_depth_maps(scene, truth, temp / "depths", 1e-5, 0);
  config.iterations = config.position_lr_max_steps = 600;
  config.position_lr_init = 1.6e-3;
  config.position_lr_final = 1.6e-4;
  config.seed = 3;
  config.sh_degree = 0;
  config.densify_from_iter = config.opacity_reset_interval = 1000;
  config.kernel = "sub-tile";
  config.test_iterations = {};
  config.stats_interval = 0;
  config.depth_l1_weight_final = 1;  // high, because there are few iterations
  TrainConfig with_depths = config;
  with_depths.depths = (temp / "depths").string();

  const Trained without = train(config, scene, temp / "without"), with = train(with_depths, scene, temp / "with");
  const double held_out = depth_error(without, scene.test, truth);
  EXPECT_LT(depth_error(with, scene.test, truth), 0.9 * held_out) << held_out;

  // Two views do not determine depths.
  scene.train.resize(2);
  const Trained two_without = train(config, scene, temp / "two_without");
  const Trained two_with = train(with_depths, scene, temp / "two_with");
  const double trained = depth_error(two_without, scene.train, truth);
  EXPECT_LT(depth_error(two_with, scene.train, truth), 0.7 * trained) << trained;

  // With a weight of 0, maps are not read.
  with_depths.depth_l1_weight_init = with_depths.depth_l1_weight_final = 0;
  with_depths.depths = "nowhere";
  EXPECT_TRUE(test::same(train(with_depths, scene, temp / "no_weight").ply, two_without.ply));
}

TEST(DepthTraining, MapsBeyondTheHostMemoryAreReadFromDisk) {
  const test::TempDir temp;
  const test::DiskScene disk;
  GaussianTensors truth;
  test::make_tiny_scene({}, &truth);
  TrainConfig config = test::eventful_config();
  config.depths = (temp / "depths").string();
  const auto run = [&](double photographs, std::vector<std::string>& warnings) {
    Scene scene = disk.load(photographs);
    test::add_depth_maps(scene, truth, temp / "depths", 1e-5, 0);
    const ImageMemory& memory = *scene.train.front().image->memory();
    const std::int64_t fixed = memory.fixed();
    std::int64_t maps = 0;
    TrainHooks hooks;
    hooks.on_warning = [&](const std::string& warning) { warnings.push_back(warning); };
    hooks.on_progress = [&](const TrainProgress&) { maps = memory.fixed() - fixed; };
    Trained trained = train(config, scene, temp / std::to_string(photographs), {}, hooks);
    EXPECT_LE(memory.peak(), memory.limit());
    EXPECT_EQ(memory.fixed(), fixed) << "nothing stays reserved";
    return std::pair{trained, maps};
  };
  std::vector<std::string> warnings;
  const auto [whole, all_maps] = run(1e6, warnings);
  EXPECT_EQ(all_maps, 7 * disk.image_bytes() / 3 * 2);
  EXPECT_TRUE(warnings.empty()) << warnings.front();
  const auto [limited, few_maps] = run(4, warnings);
  EXPECT_GT(few_maps, 0);
  EXPECT_LT(few_maps, all_maps);
  EXPECT_TRUE(test::same(limited.ply, whole.ply));
  ASSERT_EQ(warnings.size(), 1u);
  EXPECT_NE(warnings[0].find("of 7 depth maps do not fit"), std::string::npos) << warnings[0];
}

TEST(DepthTraining, ChangedMapsAreNoticedByResume) {
  const test::TempDir temp;
  GaussianTensors truth;
  Scene scene = test::make_tiny_scene({}, &truth);
  test::add_depth_maps(scene, truth, temp / "depths", 1e-5, 0);
  TrainConfig config = test::eventful_config();
  config.iterations = 3;
  config.depths = (temp / "depths").string();
  const std::filesystem::path checkpoint = train(config, scene, temp / "model").result.checkpoint;
  const auto warnings = [&] {
    std::string all;
    TrainHooks hooks;
    hooks.on_warning = [&](const std::string& warning) { all += warning + "\n"; };
    Trainer(finalize(config, scene), scene, ModelFolder(temp / "model"), hooks).resume(checkpoint);
    return all;
  };
  EXPECT_EQ(warnings(), "");
  const std::filesystem::path map = temp / "depths/view1.png";
  test::write_bytes(map, test::read_bytes(map) + "more");
  EXPECT_NE(warnings().find("depth maps of 1 of 6 photographs have changed"), std::string::npos) << warnings();
}

}  // namespace
}  // namespace b3dgs
