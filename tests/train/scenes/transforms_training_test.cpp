// Tests that training on a transforms.json scene has the same result as training on the same scene in COLMAP's format.
#include <gtest/gtest.h>

#include "model/formats/splat_formats.h"
#include "support/formats/write_transforms.h"
#include "support/train/disk_scene.h"
#include "support/train/training.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

TEST(TransformsTraining, ResultIsThatOfTheColmapScene) {
  const test::TempDir temp;
  test::TinySceneOptions options;
  options.n_gaussians = 40;
  const test::DiskScene disk(/*distorted=*/true, options);
  const fs::path source = disk.load().source_path;
  const ColmapModel model = read_colmap_model(source / "sparse/0");
  test::Json json = test::transforms_of(model);
  json["ply_file_path"] = "points.ply";
  for (std::size_t i = 0; i < model.images.size(); ++i) {
    if (i % 4 == 0) json["test_filenames"].push_back("images/" + model.images[i].name);
  }
  fs::create_directories(temp / "scene");
  fs::copy(source / "images", temp / "scene/images");
  write_file(temp / "scene/transforms.json", json.dump());
  SceneOptions colmap_options;
  colmap_options.source_path = source.string();
  colmap_options.frame = CoordinateFrame{};
  const Scene colmap = load_scene(colmap_options);
  write_point_ply(temp / "scene/points.ply", colmap.points);
  SceneOptions transforms_options;
  transforms_options.source_path = (temp / "scene").string();
  transforms_options.frame = CoordinateFrame{};
  const Scene transforms = load_scene(transforms_options);
  ASSERT_EQ(colmap.train.size(), transforms.train.size());
  EXPECT_EQ(colmap.points.positions, transforms.points.positions);

  TrainConfig config;
  config.iterations = 12;
  config.test_iterations = {};
  config.kernel = "sub-tile";
  config.stats_interval = 0;
  const test::Trained a = test::train(config, colmap, temp / "a"), b = test::train(config, transforms, temp / "b");
  const SplatCloud from_colmap = read_splat_ply(a.result.ply), from_transforms = read_splat_ply(b.result.ply);
  ASSERT_EQ(from_colmap.size(), from_transforms.size());
  const SplatCloud start = splats_from_points(colmap.points, 0, config.init_opacity, config.init_scale);
  double difference = 0, change = 0;
  for (std::size_t i = 0; i < from_colmap.means.size(); ++i) {
    difference = std::max(difference, std::abs(double{from_colmap.means[i]} - from_transforms.means[i]));
    change = std::max(change, std::abs(double{from_colmap.means[i]} - start.means[i]));
  }
  for (std::size_t i = 0; i < from_colmap.sh0.size(); ++i) {
    difference = std::max(difference, std::abs(double{from_colmap.sh0[i]} - from_transforms.sh0[i]));
  }
  // Poses differ by rounding in double precision, so some of them differ by a bit in single precision.
  EXPECT_LT(difference, 1e-4);
  EXPECT_GT(change, 1e-3);  // the training had an effect
}

}  // namespace
}  // namespace b3dgs
