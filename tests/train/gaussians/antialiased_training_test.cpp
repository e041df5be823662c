// Tests training with anti-aliasing: the filters, how they are saved, and exact resume.
#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "model/formats/splat_formats.h"
#include "model/raster_input.h"
#include "support/temp_dir.h"
#include "support/train/tiny_scene.h"
#include "support/train/training.h"
#include "train/density/row_edit.h"
#include "train/gaussians/smoothing_filter.h"

namespace b3dgs {
namespace {

using test::eventful_config;
using test::train;
using test::Trained;

std::vector<CameraView> views_of(const Scene& scene) {
  std::vector<CameraView> views;
  for (const View& view : scene.train) views.push_back(to_camera_view(view.camera));
  return views;
}

TEST(SmoothingFilter, IsAShareOfTheFinestPixelOfAllViewsThatSeeTheGaussian) {
  const Scene scene = test::make_tiny_scene();
  const std::vector<CameraView> views = views_of(scene);
  GaussianTensors gaussians = to_tensors(splats_from_points(scene.points, 0), 0, torch::kCPU);
  gaussians.means[0] = torch::tensor({1000.0f, 0.0f, 0.0f});  // visible in no view
  SmoothingFilter(views, 0.2f, torch::kCPU).compute(gaussians);

  std::vector<double> finest;
  double largest = 0;
  for (std::int64_t i = 0; i < gaussians.size(); ++i) {
    double smallest = std::numeric_limits<double>::infinity();
    for (const CameraView& view : views) {
      double camera[3];
      for (int row = 0; row < 3; ++row) {
        camera[row] = row == 0 ? view.translation.x : row == 1 ? view.translation.y : view.translation.z;
        for (int axis = 0; axis < 3; ++axis) {
          camera[row] += static_cast<double>(view.rotation(row, axis)) * gaussians.means[i][axis].item<double>();
        }
      }
      const double x = camera[0] / camera[2] * view.fx + view.cx, y = camera[1] / camera[2] * view.fy + view.cy;
      const bool is_seen = camera[2] > 0.2 && x >= -0.15 * view.width && x <= 1.15 * view.width &&
                           y >= -0.15 * view.height && y <= 1.15 * view.height;
      if (is_seen) smallest = std::min(smallest, camera[2] / std::max(view.fx, view.fy));
    }
    finest.push_back(smallest);
    if (std::isfinite(smallest)) largest = std::max(largest, smallest);
  }
  ASSERT_TRUE(std::isinf(finest[0]));
  ASSERT_GT(largest, 0);
  for (std::size_t i = 0; i < finest.size(); ++i) {
    const double wanted = std::sqrt(0.2) * (std::isfinite(finest[i]) ? finest[i] : largest);
    EXPECT_NEAR(gaussians.filters[static_cast<std::int64_t>(i)].item<double>(), wanted, 1e-5 * wanted) << i;
  }
}

TEST(SmoothingFilter, ARowEditMakesFiltersUndefined) {
  const Scene scene = test::make_tiny_scene();
  GaussianTensors gaussians = to_tensors(splats_from_points(scene.points, 0), 0, torch::kCPU);
  SmoothingFilter filter(views_of(scene), 0.2f, torch::kCPU);
  filter.compute(gaussians);
  AdamState adam = make_adam_state(gaussians);
  DensityStatistics statistics = make_density_statistics(gaussians.size(), torch::kCPU);
  RowEdit edit;
  edit.sources = torch::arange(gaussians.size() - 1, torch::kInt64);
  edit.n_kept = edit.sources.size(0);
  edit.new_means = edit.new_log_scales = torch::empty({0, 3});
  apply_row_edit(edit, gaussians, adam, statistics);
  EXPECT_FALSE(gaussians.filters.defined());
  filter.compute(gaussians);
  EXPECT_EQ(gaussians.filters.size(0), edit.n_kept);
}

TrainConfig antialiased_config() {
  TrainConfig config = eventful_config();
  config.antialiasing = true;
  return config;
}

TEST(AntialiasedTraining, ThePlyRendersAsTheModelThatItWasSavedFrom) {
  Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = antialiased_config();
  config.iterations = 9;    // no round of density control at the end
  config.init_scale = 0.1;  // small enough that the filters matter
  Trainer trainer(finalize(config, scene), scene, ModelFolder(temp / "model"), {});
  const TrainResult result = trainer.run();
  const double of_model = trainer.evaluate(scene.train).mean.psnr;

  const SplatCloud cloud = read_splat_ply(result.ply);
  EXPECT_TRUE(cloud.antialiased);
  const GaussianTensors gaussians = to_tensors(cloud, 1, torch::kCPU);
  Rasterizer rasterizer(torch::kCPU);
  RenderSettings settings = base_render_settings(config, trainer.sh_degree());
  const double of_ply = evaluate_views(rasterizer, gaussians, scene.train, settings).mean.psnr;
  EXPECT_NEAR(of_ply, of_model, 1e-3);
  settings.antialiasing = false;
  const double without = evaluate_views(rasterizer, gaussians, scene.train, settings).mean.psnr;
  EXPECT_GT(std::abs(without - of_model), 0.01) << "anti-aliasing makes no difference here";
}

TEST(AntialiasedTraining, APlyOfItIsContinuedWithoutItOnlyWithAWarning) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = antialiased_config();
  config.iterations = 2;
  config.init_ply = train(config, scene, temp / "model").result.ply.string();
  const auto warnings = [&](bool antialiasing) {
    std::string all;
    TrainHooks hooks;
    hooks.on_warning = [&](const std::string& warning) { all += warning + "\n"; };
    config.antialiasing = antialiasing;
    Trainer(finalize(config, scene), scene, ModelFolder(temp / (antialiasing ? "with" : "without")), hooks).run();
    return all;
  };
  EXPECT_NE(warnings(false).find("add --antialiasing"), std::string::npos);
  EXPECT_EQ(warnings(true), "");
}

TEST(AntialiasedTraining, CanBeTurnedOffAndOnWhenResumed) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = antialiased_config();
  config.iterations = 6;
  const Trained first = train(config, scene, temp / "model");
  config.iterations = 8;
  config.antialiasing = false;
  const Trained second = train(config, scene, temp / "model", first.result.checkpoint);
  EXPECT_FALSE(read_splat_ply(second.result.ply).antialiased);
  config.iterations = 9;
  config.antialiasing = true;
  const Trained third = train(config, scene, temp / "model", second.result.checkpoint);
  EXPECT_TRUE(read_splat_ply(third.result.ply).antialiased);
}

}  // namespace
}  // namespace b3dgs
