// Tests training with masks: masked pixels have no effect, and with --mask_mode segment they become empty.
#include <gtest/gtest.h>

#include "model/formats/splat_formats.h"
#include "support/same.h"
#include "support/train/disk_scene.h"
#include "support/train/training.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

TrainConfig short_config() {
  TrainConfig config;
  config.iterations = config.position_lr_max_steps = 60;
  config.seed = 3;
  config.sh_degree = 0;
  config.densify_from_iter = 20;
  config.densification_interval = 20;
  config.kernel = "sub-tile";
  config.test_iterations = {};
  config.stats_interval = 0;
  return config;
}

// Draws a block that moves from photograph to photograph, white in an image or black in a white mask.
void draw_object(Image8& image, std::size_t view, std::uint8_t value) {
  const int left = static_cast<int>(5 + 7 * view % 35), top = static_cast<int>(4 + 5 * view % 22);
  for (int y = top; y < top + 14; ++y) {
    for (int x = left; x < left + 14; ++x) {
      for (int c = 0; c < image.channels; ++c) {
        image.pixels[static_cast<std::size_t>((y * image.width + x) * image.channels + c)] = value;
      }
    }
  }
}

double mean_psnr(const test::Trained& run, const Scene& scene) {
  Rasterizer rasterizer(torch::kCPU);
  const GaussianTensors model = to_tensors(read_splat_ply(run.result.ply), 0, torch::kCPU);
  return evaluate_views(rasterizer, model, scene.test, {}).mean.psnr;
}

TEST(MaskTraining, WhatIsIgnoredLeavesNoTrace) {
  const test::TempDir temp;
  test::TinySceneOptions options;
  options.n_gaussians = 60;
  const test::DiskScene disk(/*distorted=*/false, options);
  const Scene clean_without_masks = disk.load();
  const fs::path source = clean_without_masks.source_path;
  const std::size_t n_train = clean_without_masks.train.size();
  for (std::size_t i = 0; i < n_train; ++i) {
    const View& view = clean_without_masks.train[i];
    Image8 mask(view.camera.width, view.camera.height, 1);
    std::fill(mask.pixels.begin(), mask.pixels.end(), std::uint8_t{255});
    draw_object(mask, i, 0);
    write_image(source / "masks" / view.name, mask);
  }
  const test::Trained clean = test::train(short_config(), disk.load(), temp / "clean");
  for (std::size_t i = 0; i < n_train; ++i) {
    Image8 photograph = *clean_without_masks.train[i].image->read();
    draw_object(photograph, i, 255);
    write_image(disk.image_file(clean_without_masks.train[i]), photograph);
  }
  const test::Trained masked = test::train(short_config(), disk.load(), temp / "masked");
  EXPECT_TRUE(test::same(masked.ply, clean.ply));
  remove_tree(source / "masks");
  const Scene painted = disk.load();
  EXPECT_EQ(painted.train[0].valid, nullptr);
  const test::Trained unmasked = test::train(short_config(), painted, temp / "unmasked");
  EXPECT_FALSE(unmasked.ply == clean.ply);
}

// Returns the mean alpha of the model over the pixels where View::empty is set.
double mean_empty_alpha(const std::string& ply, const std::vector<View>& views) {
  Rasterizer rasterizer(torch::kCPU);
  const GaussianTensors model = to_tensors(read_splat_ply(ply), 0, torch::kCPU);
  double sum = 0, n = 0;
  for (const View& view : views) {
    const torch::Tensor alpha = rasterizer.forward(model, to_camera_view(view.camera), {}).alpha.contiguous();
    for (std::size_t i = 0; i < view.empty->pixels.size(); ++i) {
      if (view.empty->pixels[i] == 0) continue;
      sum += alpha.data_ptr<float>()[i];
      n += 1;
    }
  }
  return sum / n;
}

// Returns a scene with a small object in front of a grey wall that is masked. Half of the initial points are above and
// below the object, where no training view shows it, so only the masks require that this space is empty.
Scene segmented_scene() {
  test::TinySceneOptions options;
  options.n_gaussians = 200;
  options.log_scale = -2.8f;
  GaussianTensors truth;
  Scene scene = test::make_tiny_scene(options, &truth);
  const torch::Tensor rows = (truth.means.norm(2, 1) < 0.4).nonzero().flatten();
  for (torch::Tensor* group : truth.all()) *group = group->index_select(0, rows).contiguous();
  Rasterizer rasterizer(torch::kCPU);
  for (std::vector<View>* views : {&scene.train, &scene.test}) {
    for (View& view : *views) {
      const RenderedView rendered = rasterizer.forward(truth, to_camera_view(view.camera), {});
      const torch::Tensor alpha = rendered.alpha.contiguous();
      auto valid = std::make_shared<Image8>(view.camera.width, view.camera.height, 1);
      auto empty = std::make_shared<Image8>(view.camera.width, view.camera.height, 1);
      Image8 image = to_image8(rendered.color);
      for (std::size_t i = 0; i < valid->pixels.size(); ++i) {
        const bool is_object = alpha.data_ptr<float>()[i] > 0;
        valid->pixels[i] = is_object ? 255 : 0;
        empty->pixels[i] = is_object ? 0 : 255;
        for (std::size_t c = 0; c < 3 && !is_object; ++c) image.pixels[3 * i + c] = 150;
      }
      view.valid = valid;
      view.empty = empty;
      view.image = std::make_shared<ViewImage>(std::move(image));
    }
  }
  scene.points = {};
  const torch::Tensor means = truth.means.contiguous();
  for (std::int64_t i = 0; i < truth.size(); ++i) {
    const auto place = random_uniform({5, RandomStream::kSplit, 0}, static_cast<std::uint64_t>(i));
    for (std::int64_t axis = 0; axis < 3; ++axis)
      scene.points.positions.push_back(means.data_ptr<float>()[3 * i + axis]);
    const float y = 0.8f + 0.15f * place[1];
    for (const float at : {0.4f * (place[0] - 0.5f), i % 2 == 0 ? y : -y, 0.4f * (place[2] - 0.5f)}) {
      scene.points.positions.push_back(at);
    }
  }
  scene.points.colors.assign(scene.points.positions.size(), 150);
  return scene;
}

TEST(MaskTraining, SegmentedBackgroundBecomesEmpty) {
  const test::TempDir temp;
  const Scene scene = segmented_scene();
  TrainConfig config = short_config();
  config.iterations = config.position_lr_max_steps = 200;
  config.densify_from_iter = 1000;
  config.init_opacity = 0.6;
  const test::Trained ignored = test::train(config, scene, temp / "ignored");
  config.mask_mode = MaskMode::kSegment;
  const test::Trained segmented = test::train(config, scene, temp / "segmented");
  const double before = mean_empty_alpha(ignored.result.ply, scene.test);
  const double after = mean_empty_alpha(segmented.result.ply, scene.test);
  EXPECT_GT(before, 0.03);  // from points that no photograph contradicts
  // After this short training, the rim of the object's own Gaussians remains.
  EXPECT_LT(after, 0.01);
  EXPECT_LT(after, before / 3);
  EXPECT_GT(mean_psnr(segmented, scene), mean_psnr(ignored, scene) - 0.5);  // the object is still there
}

TEST(MaskTraining, SegmentModeWorksFromCoarseToFineAndInBatches) {
  const test::TempDir temp;
  const Scene scene = segmented_scene();
  TrainConfig config = short_config();
  config.iterations = config.position_lr_max_steps = 200;
  config.densify_from_iter = 1000;
  config.coarse_scale = 2;
  config.coarse_until = 150;
  config.batch = 2;
  const test::Trained ignored = test::train(config, scene, temp / "ignored");
  config.mask_mode = MaskMode::kSegment;
  const test::Trained segmented = test::train(config, scene, temp / "segmented");
  EXPECT_LT(mean_empty_alpha(segmented.result.ply, scene.test), 0.5 * mean_empty_alpha(ignored.result.ply, scene.test));
}

}  // namespace
}  // namespace b3dgs
