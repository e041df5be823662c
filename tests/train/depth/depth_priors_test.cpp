// Tests reading and aligning inverse depth maps, and the gradient of their loss.
#include "train/depth/depth_priors.h"

#include <gtest/gtest.h>

#include <cmath>
#include <fstream>

#include "core/files/atomic_file.h"
#include "scene/colmap/colmap.h"
#include "scene/images/image.h"
#include "support/approx.h"
#include "support/expect_error.h"
#include "support/files.h"
#include "support/finite_difference.h"
#include "support/temp_dir.h"
#include "support/train/depth_maps.h"
#include "support/train/disk_scene.h"
#include "train/training_views.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

constexpr double kScale = 1e-5, kOffset = -0.03;

std::vector<double> uneven_values(std::size_t n) {
  std::vector<double> values;
  for (std::size_t i = 0; i < n; ++i) values.push_back(1000 + 700 * std::sin(3.7 * static_cast<double>(i)));
  return values;
}

TEST(DepthAlignment, FindsScaleAndOffset) {
  for (const std::size_t n : {11u, 12u, 500u}) {
    const std::vector<double> values = uneven_values(n);
    std::vector<double> inverse;
    for (const double value : values) inverse.push_back(0.002 * value + 0.4);
    const DepthAlignment found = align_depth(values, inverse).value();
    EXPECT_NEAR(found.scale, 0.002, 1e-12);
    EXPECT_NEAR(found.offset, 0.4, 1e-9);
  }
}

TEST(DepthAlignment, IsThatOfTheMediansAndTheMeanDeviationsFromThem) {
  // The medians are 5 and 2, and the mean deviations (5 + 4 + 3 + 2 + 1 + 0 + 1 + 2 + 3 + 4 + 95) / 11 and 10 / 11.
  const std::vector<double> values{0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 100}, inverse{1, 1, 1, 1, 1, 2, 3, 3, 3, 3, 3};
  const DepthAlignment found = align_depth(values, inverse).value();
  EXPECT_NEAR(found.scale, 10.0 / 120.0, 1e-12);
  EXPECT_NEAR(found.offset, 2 - 5 * 10.0 / 120.0, 1e-12);
}

TEST(DepthAlignment, NeedsMoreThanTenPointsAtDifferentDepths) {
  EXPECT_FALSE(align_depth(uneven_values(10), uneven_values(10)).has_value());
  EXPECT_TRUE(align_depth(uneven_values(11), uneven_values(11)).has_value());
  EXPECT_FALSE(align_depth(std::vector<double>(20, 7.0), uneven_values(20)).has_value());
  EXPECT_FALSE(align_depth(uneven_values(20), std::vector<double>(20, 7.0)).has_value());
}

TEST(DepthAlignment, RemovesScalesFarFromTheMedian) {
  std::vector<std::optional<DepthAlignment>> alignments;
  for (const double scale : {1.0, 0.2, 5.0, 0.19, 5.1, 1.0, 1.0}) alignments.push_back(DepthAlignment{scale, 0});
  alignments.insert(alignments.begin(), std::nullopt);
  remove_unlikely_alignments(alignments);
  for (const std::size_t left_out : {0u, 4u, 5u}) EXPECT_FALSE(alignments[left_out].has_value()) << left_out;
  for (const std::size_t used : {1u, 2u, 3u, 6u, 7u}) EXPECT_TRUE(alignments[used].has_value()) << used;
  std::vector<std::optional<DepthAlignment>> none(3);
  remove_unlikely_alignments(none);
  EXPECT_FALSE(none[0].has_value());
}

struct SceneWithDepth {
  explicit SceneWithDepth(bool masked = false) {
    test::TinySceneOptions options;
    options.masked = masked;
    scene = test::make_tiny_scene(options, &truth);
    test::add_depth_maps(scene, truth, folder.path(), kScale, kOffset);
  }
  DepthPriors priors() const { return {folder.path().string(), scene, torch::kCPU}; }
  fs::path file(std::size_t view) const { return folder / fs::path(scene.train[view].name).filename(); }
  bool is_refused(const std::vector<std::string>& words) const {
    try {
      priors();
    } catch (const InputError& error) {
      for (const std::string& word : words) {
        EXPECT_NE(std::string(error.what()).find(word), std::string::npos) << error.what();
      }
      return true;
    }
    return false;
  }

  test::TempDir folder;
  GaussianTensors truth;
  Scene scene;
};

TEST(DepthPriors, AreAlignedWithThePointsOfTheScene) {
  const SceneWithDepth with;
  const DepthPriors priors = with.priors();
  EXPECT_TRUE(priors.warnings().empty());
  for (std::size_t view = 0; view < with.scene.train.size(); ++view) {
    ASSERT_GT(with.scene.train[view].points.size(), 15u);
    const std::optional<DepthAlignment>& found = priors.alignment(static_cast<std::int32_t>(view));
    ASSERT_TRUE(found.has_value());
    EXPECT_NEAR(found->scale, kScale, 0.001 * kScale);
    EXPECT_NEAR(found->offset, kOffset, 1e-4);
  }
}

TEST(DepthPriors, GradientIsThatOfTheMeanAbsoluteDifference) {
  for (const bool masked : {false, true}) {
    SCOPED_TRACE(masked);
    const SceneWithDepth with(masked);
    DepthPriors priors = with.priors();
    const View& view = with.scene.train[1];
    const Image8* const mask = view.valid.get();
    const int width = view.camera.width, height = view.camera.height;
    const Depth16 map = read_depth_map(with.file(1));
    const DepthAlignment alignment = priors.alignment(1).value();
    const auto is_valid = [&](int x, int y) {
      return mask == nullptr || mask->pixels[static_cast<std::size_t>(y * width + x)] != 0;
    };
    const auto mask_tensor = [](const Image8* own) {
      if (own == nullptr) return torch::Tensor();
      return torch::from_blob(const_cast<std::uint8_t*>(own->pixels.data()), {own->height, own->width}, torch::kUInt8)
          .clone();
    };
    for (const int reduction : {1, 2}) {
      SCOPED_TRACE(reduction);
      TrainView full{
          view.name, 1, to_camera_view(view.camera), torch::zeros({height, width, 3}, torch::kUInt8), mask_tensor(mask),
          {},        0};
      full.n_valid = full.valid.defined() ? (full.valid != 0).sum().item<std::int64_t>() : std::int64_t{width} * height;
      ViewReducer reducer(torch::kCPU);
      const TrainView reduced = reducer.reduce(full, mask, reduction);
      const int w = reduced.camera.width, h = reduced.camera.height;
      // Computes the targets and the loss independently.
      std::vector<double> targets, used;
      std::int64_t n_valid = 0;
      for (int y = 0; y < h; ++y) {
        for (int x = 0; x < w; ++x) {
          double sum = 0;
          int count = 0;
          for (int j = reduction * y; j < reduction * (y + 1); ++j) {
            for (int i = reduction * x; i < reduction * (x + 1); ++i) {
              if (!is_valid(i, j)) continue;
              sum += map.pixels[static_cast<std::size_t>(j * width + i)];
              ++count;
            }
          }
          const bool is_used = 2 * count >= reduction * reduction;
          targets.push_back(is_used ? alignment.scale * sum / count + alignment.offset : 0);
          used.push_back(is_used ? 1 : 0);
          n_valid += is_used ? 1 : 0;
        }
      }
      ASSERT_EQ(n_valid, reduced.n_valid);
      torch::manual_seed(2);
      const torch::Tensor rendered = 0.3 + 0.4 * torch::rand({h, w});
      const torch::Tensor grad =
          priors.gradient(1, rendered, reduced.valid, reduced.n_valid, full.valid, /*weight=*/0.7);
      const auto loss = [&](const std::vector<double>& values) {
        double sum = 0;
        for (std::size_t p = 0; p < values.size(); ++p) sum += used[p] * std::abs(values[p] - targets[p]);
        return 0.7 * sum / static_cast<double>(n_valid);
      };
      std::vector<double> at, found;
      for (std::int64_t p = 0; p < rendered.numel(); ++p) {
        at.push_back(rendered.flatten()[p].item<double>());
        found.push_back(grad.flatten()[p].item<double>());
      }
      EXPECT_TRUE(test::gradients_agree(found, test::numeric_gradient(loss, at, 1e-5), 1e-5));
    }
  }
}

TEST(DepthPriors, LeaveOutViewsAndCountThem) {
  SceneWithDepth with;
  fs::remove(with.file(0));
  with.scene.train[1].points.resize(10);
  Depth16 map = read_depth_map(with.file(2));
  for (std::uint16_t& value : map.pixels) value = static_cast<std::uint16_t>(value / 30);
  test::write_depth_png(with.file(2), map.width, map.height, map.pixels);
  const DepthPriors priors = with.priors();
  ASSERT_EQ(priors.warnings().size(), 3u);
  EXPECT_EQ(priors.warnings()[0].rfind("1 of 6 training views have no depth map (first: view1.png)", 0), 0u)
      << priors.warnings()[0];
  EXPECT_EQ(priors.warnings()[1].rfind("1 of 6 training views see too few points", 0), 0u) << priors.warnings()[1];
  EXPECT_NE(priors.warnings()[2].find("outside 0.2 to 5 times the median"), std::string::npos);
  for (const std::int32_t view : {0, 1, 2}) EXPECT_FALSE(priors.has(view)) << view;
  for (const std::int32_t view : {3, 4, 5}) EXPECT_TRUE(priors.has(view)) << view;
}

TEST(DepthPriors, RefuseFilesThatAreNoDepthMaps) {
  const SceneWithDepth with;
  const Depth16 map = read_depth_map(with.file(3));
  write_image(with.file(3), Image8(60, 44, 1));
  EXPECT_TRUE(with.is_refused({with.file(3).string(), "one channel with 16 bits", "1 channel with 8 bits"}));
  write_image(with.file(3), Image8(60, 44, 3));
  EXPECT_TRUE(with.is_refused({with.file(3).string(), "found 3 channels with 8 bits"}));
  test::write_depth_png(with.file(3), map.height, map.width, map.pixels);
  EXPECT_TRUE(with.is_refused({with.file(3).string(), "60 x 44 px", "44 x 60 px"}));
  write_file(with.file(3), "no image");
  EXPECT_TRUE(with.is_refused({with.file(3).string()}));
}

TEST(DepthPriors, MapsOfAnotherSizeAreResized) {
  const SceneWithDepth with;
  const Depth16 map = read_depth_map(with.file(0));
  Depth16 large(2 * map.width, 2 * map.height);
  for (std::size_t y = 0; y < 88; ++y) {
    for (std::size_t x = 0; x < 120; ++x) large.pixels[y * 120 + x] = map.pixels[y / 2 * 60 + x / 2];
  }
  const DepthAlignment before = with.priors().alignment(0).value();
  test::write_depth_png(with.file(0), large.width, large.height, large.pixels);
  const DepthAlignment after = with.priors().alignment(0).value();
  EXPECT_NEAR(after.scale, before.scale, 1e-9);
  EXPECT_NEAR(after.offset, before.offset, 1e-6);
}

TEST(DepthPriors, MapsOfDistortedPhotographsAreUndistortedAndReducedLikeThem) {
  const test::DiskScene disk(/*distorted=*/true);
  const Scene scene = disk.load();
  const View& view = scene.train[0];
  ASSERT_NE(view.valid, nullptr);
  // Uses a map with the values of the photograph's red channel.
  const Image8 photograph = read_image(disk.image_file(view), false);
  std::vector<std::uint16_t> values;
  for (std::size_t p = 0; p < photograph.pixels.size(); p += 3) {
    values.push_back(static_cast<std::uint16_t>(257 * photograph.pixels[p]));
  }
  const test::TempDir temp;
  test::write_depth_png(temp / "map.png", photograph.width, photograph.height, values);
  const Depth16 map = view.image->read_depth(temp / "map.png");
  const std::shared_ptr<const Image8> image = view.image->read();
  ASSERT_EQ(map.pixels.size(), view.valid->pixels.size());
  for (std::size_t p = 0; p < map.pixels.size(); ++p) {
    if (view.valid->pixels[p] == 0) continue;
    EXPECT_NEAR(map.pixels[p] / 257.0, static_cast<double>(image->pixels[3 * p]), 1.5) << p;
  }
}

TEST(DepthPriors, NeedAFolderWithMapsAndPoints) {
  SceneWithDepth with;
  EXPECT_TRUE(test::fails_with<InputError>({"folder of depth maps not found: nowhere"},
                                           [&] { DepthPriors("nowhere", with.scene, torch::kCPU); }));
  const test::TempDir empty;
  EXPECT_TRUE(test::fails_with<InputError>({"no depth map found", "view1.png"},
                                           [&] { DepthPriors(empty.path().string(), with.scene, torch::kCPU); }));
  for (View& view : with.scene.train) view.points.clear();
  EXPECT_TRUE(with.is_refused({"no depth map can be aligned", "11 points in its tracks"}));
}

}  // namespace
}  // namespace b3dgs
