// Tests that the result does not depend on a scene's unit of length, or on its position or orientation in the world.
#include <gtest/gtest.h>

#include <array>
#include <cmath>

#include "core/config.h"
#include "model/cameras/cameras_json.h"
#include "model/formats/splat_formats.h"
#include "scene/cameras/coordinate_frame.h"
#include "support/expect_error.h"
#include "support/train/disk_scene.h"
#include "support/train/training.h"
#include "train/checkpoint/checkpoint.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using Vec = std::array<double, 3>;

/// x' = scale * turn * x + shift
struct Motion {
  double scale = 1;
  Vec shift{};
  std::array<double, 9> turn{1, 0, 0, 0, 1, 0, 0, 0, 1};

  Vec operator()(const Vec& x) const {
    Vec moved = shift;
    for (std::size_t row = 0; row < 3; ++row) {
      for (std::size_t axis = 0; axis < 3; ++axis) moved[row] += scale * turn[3 * row + axis] * x[axis];
    }
    return moved;
  }
};

/// Writes a copy of the scene folder in which everything is moved.
void write_moved(const fs::path& source, const Motion& motion, const fs::path& folder) {
  ColmapModel model = read_colmap_model(source / "sparse/0");
  for (ColmapImage& image : model.images) {
    Camera camera;
    camera.cam_from_world = {rotation_from_quaternion(image.quat), image.translation};
    const Vec center = motion(camera.center());
    std::array<double, 9> rotation{};
    for (std::size_t i = 0; i < 3; ++i) {
      for (std::size_t j = 0; j < 3; ++j) {
        for (std::size_t k = 0; k < 3; ++k) {
          rotation[3 * i + j] += camera.cam_from_world.rotation[3 * i + k] * motion.turn[3 * j + k];
        }
      }
    }
    image.quat = quaternion_from_rotation(rotation);
    for (std::size_t i = 0; i < 3; ++i) {
      image.translation[i] = 0;
      for (std::size_t j = 0; j < 3; ++j) image.translation[i] -= rotation[3 * i + j] * center[j];
    }
  }
  for (ColmapPoint& point : model.points) point.position = motion(point.position);
  write_colmap_model(folder / "sparse/0", model, ColmapFormat::kBinary);
  fs::copy(source / "images", folder / "images");
}

class FrameTraining : public ::testing::Test {
 protected:
  FrameTraining() {
    config_.iterations = 60;
    config_.test_iterations = {60};
    config_.max_gaussians = 308;
    config_.densify_from_iter = 5;
    config_.densification_interval = 10;
    config_.densify_until_iter = 50;
    config_.kernel = "sub-tile";
    config_.stats_interval = 0;
    config_.eval = true;
  }
  Scene load_moved(const std::string& name, const Motion& motion) {
    write_moved(disk_.load().source_path, motion, folder_ / name);
    SceneOptions options;
    options.source_path = (folder_ / name).string();
    options.eval = true;
    return load_scene(options);
  }

  const test::DiskScene disk_;
  const test::TempDir folder_;
  TrainConfig config_;
};

TEST_F(FrameTraining, ResultsAreTheSameInEveryUnitPlaceAndOrientation) {
  const double c = std::cos(1.0), s = std::sin(1.0);
  const std::array<double, 9> turn{c, -s, 0, s, c, 0, 0, 0, 1};
  const Scene given = load_moved("given", {});
  for (const Strategy own : {Strategy::kBudget, Strategy::kMcmc}) {
    config_.strategy = own;
    const std::string strategy = name_of(own);
    const test::Trained base = test::train(config_, given, folder_ / ("model_" + strategy));
    const double psnr = base.result.evaluations.back().second.mean.psnr;
    const SplatCloud cloud = read_splat_ply(base.result.ply);
    int i = 0;
    for (const Motion& motion : {Motion{1e-4}, Motion{1e4}, Motion{1, {1e6, -2e6, 3e5}}, Motion{1, {}, turn},
                                 Motion{0.03, {1e6, 0, 0}, turn}}) {
      SCOPED_TRACE(testing::Message() << strategy << ", motion " << i);
      const std::string name = strategy + std::to_string(i++);
      const Scene scene = load_moved(name, motion);
      const test::Trained moved = test::train(config_, scene, folder_ / ("model_" + name));
      // Children of splits are scattered along the axes of the world, so a rotation has the effect of another seed.
      EXPECT_NEAR(moved.result.evaluations.back().second.mean.psnr, psnr, motion.turn[0] == 1 ? 0.02 : 0.3);
      const auto n = static_cast<double>(base.result.n_gaussians);
      EXPECT_NEAR(static_cast<double>(moved.result.n_gaussians), n, 0.02 * n);
      // The file is in the user's coordinates.
      const SplatCloud other = read_splat_ply(moved.result.ply);
      const CoordinateFrame around = choose_frame({}, world_positions(cloud));
      const CoordinateFrame of_other = choose_frame({}, world_positions(other));
      const Vec expected = motion(around.origin);
      for (std::size_t axis = 0; axis < 3; ++axis) {
        EXPECT_NEAR(of_other.origin[axis], expected[axis], 0.1 * motion.scale);
      }
      EXPECT_NEAR(of_other.unit / around.unit, motion.scale, 0.1 * motion.scale);
      EXPECT_EQ(moved.ply.find("property double x") != std::string::npos, motion.shift[0] != 0);
      const std::vector<NamedCamera> cameras = read_cameras_json(ModelFolder(folder_ / ("model_" + name)).cameras());
      const Vec center = motion(change_frame(given.frame, {}, given.test[0].camera).center());
      for (std::size_t axis = 0; axis < 3; ++axis) {
        EXPECT_NEAR(cameras[0].camera.center()[axis], center[axis], 1e-6 * motion.scale + 1e-9);
      }
    }
  }
}

TEST_F(FrameTraining, AFarSceneResumesExactly) {
  const Scene far = load_moved("far", {0.5, {1e6, -2e6, 3e5}});
  test::expect_exact_resume(config_, far, test::train(config_, far, folder_ / "whole"), folder_.path(), {25});
}

TEST_F(FrameTraining, ACheckpointBelongsToTheFrameThatItWasTrainedIn) {
  const Scene scene = load_moved("given", {});
  const test::Trained whole = test::train(config_, scene, folder_ / "whole");
  const nlohmann::ordered_json header = read_checkpoint_header(whole.result.checkpoint);
  EXPECT_EQ(checkpoint_frame(header, ""), scene.frame);
  SceneOptions options = *scene.options;
  options.frame = CoordinateFrame{};
  const Scene world = load_scene(options);
  EXPECT_NE(world.frame, scene.frame);
  EXPECT_TRUE(test::fails_with<LogicError>({"another frame"}, [&] { check_scene(header, world, "a.b3dgs"); }));
  nlohmann::ordered_json damaged = header;
  for (const nlohmann::ordered_json& unit : {nlohmann::ordered_json(0), nlohmann::ordered_json("1")}) {
    damaged["scene"]["frame"] = {{"origin", {0, 0, 0}}, {"unit", unit}};
    EXPECT_TRUE(test::fails_with<InputError>({"a.b3dgs", "invalid checkpoint header"},
                                             [&] { checkpoint_frame(damaged, "a.b3dgs"); }));
  }
}

}  // namespace
}  // namespace b3dgs
