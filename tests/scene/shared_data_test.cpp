// Real scenes, skipped if they are not available. Each loads, or is rejected, as described in their README.
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <set>

#include "core/check.h"
#include "scene/images/image.h"
#include "scene/scene.h"
#include "scene/view_image.h"
#include "support/expect_error.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using test::fails_with;

struct OddScene {
  const char* folder;
  std::size_t n_views;  // 0: rejected
  std::int64_t n_points;
  std::size_t n_sizes;  // different sizes among the views
  bool is_distorted;
  const char* says;  // part of the summary, or of the error
};

class RealScene : public testing::TestWithParam<OddScene> {};

SceneOptions options_for(const std::string& folder) {
  SceneOptions options;
  options.source_path = (fs::path(B3DGS_SHARED_DATA) / folder).string();
  return options;
}

TEST_P(RealScene, LoadsOrIsRejected) {
  const OddScene& expected = GetParam();
  const SceneOptions options = options_for(expected.folder);
  if (!fs::exists(options.source_path)) GTEST_SKIP() << options.source_path << " not found";
  if (expected.n_views == 0) {
    EXPECT_TRUE(fails_with<InputError>({options.source_path, expected.says}, [&] { load_scene(options); }));
    return;
  }
  const Scene scene = load_scene(options);
  EXPECT_EQ(scene.train.size(), expected.n_views);
  EXPECT_EQ(scene.points.size(), expected.n_points);
  EXPECT_GT(scene.extent, 0);
  std::set<std::pair<int, int>> sizes;
  for (const View& view : scene.train) {
    sizes.insert({view.camera.width, view.camera.height});
    EXPECT_EQ(view.image->size().width, view.camera.width);
    EXPECT_EQ(view.image->size().height, view.camera.height);
    EXPECT_EQ(view.image->read()->channels, 3);
  }
  EXPECT_EQ(sizes.size(), expected.n_sizes);
  std::string summary;
  for (const std::string& line : scene.summary) summary += line + "\n";
  EXPECT_NE(summary.find(expected.says), std::string::npos) << summary;
  EXPECT_EQ(summary.find("distortion  none") == std::string::npos, expected.is_distorted) << summary;
}

INSTANTIATE_TEST_SUITE_P(
    Folders, RealScene,
    testing::Values(OddScene{"fox", 50, 12113, 1, false, "50 registered, 50 found"},
                    OddScene{"fox_distorted", 50, 12113, 1, true, "OPENCV 540x960"},
                    OddScene{"bonsai", 88, 53730, 1, false, "PINHOLE 3118x2078"},
                    OddScene{"kitti_street", 24, 60393, 1, false, "1242x375"},
                    OddScene{"odd/text_simple_pinhole", 4, 1039, 1, false, "SIMPLE_PINHOLE 1919x1079"},
                    OddScene{"odd/text_fisheye_rig_commas", 6, 0, 1, true, "the scene has no points"},
                    OddScene{"odd/text_radial_ids_from_0", 3, 1721, 1, true, "3 registered, 3 found"},
                    OddScene{"odd/text_pinhole_no_images", 0, 0, 0, false, "none of the 11 registered images"},
                    OddScene{"odd/text_unsorted_ids", 0, 0, 0, false, "none of the 3 registered images"},
                    OddScene{"odd/rgba_png_camera_id_0", 2, 1465, 1, false, "2 missing (00000001.png, 00000004.png)"},
                    OddScene{"odd/sparse_no_subdir_multicam", 7, 699, 6, false, "sparse, binary"},
                    OddScene{"odd/simple_radial_multicam", 7, 699, 1, true, "7 x SIMPLE_RADIAL 1280x720"},
                    OddScene{"odd/truck_prefixed_names", 11, 8143, 1, false, "11 registered, 11 found"},
                    OddScene{"odd/fox12_simple_pinhole", 12, 1552, 1, false, "SIMPLE_PINHOLE 270x480"},
                    OddScene{"odd/fox12_opencv_fisheye", 12, 1552, 1, true, "OPENCV_FISHEYE"},
                    OddScene{"odd/fox4_full_opencv", 4, 963, 1, true, "FULL_OPENCV"},
                    OddScene{"odd/fox6_text_radial_subfolders", 6, 1126, 1, true, "2 x RADIAL"},
                    OddScene{"odd/fox12_missing_images", 9, 1552, 1, true,
                             "3 missing (0003.jpg, 0009.jpg, 0019.jpg), 1 more"}),
    [](const auto& info) {
      std::string name = fs::path(info.param.folder).filename().string();
      return name;
    });

// fox is fox_distorted after COLMAP's image_undistorter. The two pinhole cameras differ only in scale and crop.
TEST(RealScenes, UndistortionAgreesWithColmaps) {
  if (!fs::exists(options_for("fox").source_path)) GTEST_SKIP() << "real scenes not found";
  const Scene ours = load_scene(options_for("fox_distorted")), theirs = load_scene(options_for("fox"));
  ASSERT_EQ(ours.train.size(), theirs.train.size());
  double squared = 0;
  std::size_t n = 0;
  for (std::size_t i = 0; i < ours.train.size(); i += 10) {
    const View &a = ours.train[i], &b = theirs.train[i];
    ASSERT_EQ(a.name, b.name);
    const auto a_image = a.image->read(), b_image = b.image->read();
    for (int row = 0; row < b.camera.height; ++row) {
      for (int column = 0; column < b.camera.width; ++column) {
        const double x = (column + 0.5 - b.camera.cx) / b.camera.fx, y = (row + 0.5 - b.camera.cy) / b.camera.fy;
        const double u = x * a.camera.fx + a.camera.cx - 0.5, v = y * a.camera.fy + a.camera.cy - 0.5;
        const int u0 = static_cast<int>(std::floor(u)), v0 = static_cast<int>(std::floor(v));
        if (u0 < 0 || v0 < 0 || u0 + 1 >= a.camera.width || v0 + 1 >= a.camera.height) continue;
        const auto pixel = [&](int dx, int dy) { return static_cast<std::size_t>(v0 + dy) * a.camera.width + u0 + dx; };
        if (a.valid && (!a.valid->pixels[pixel(0, 0)] || !a.valid->pixels[pixel(1, 1)])) continue;
        for (int c = 0; c < 3; ++c) {
          const auto at = [&](int dx, int dy) { return double{1} * a_image->pixels[3 * pixel(dx, dy) + c]; };
          const double fu = u - u0, fv = v - v0;
          const double value =
              (1 - fv) * ((1 - fu) * at(0, 0) + fu * at(1, 0)) + fv * ((1 - fu) * at(0, 1) + fu * at(1, 1));
          const double other = b_image->pixels[(static_cast<std::size_t>(row) * b.camera.width + column) * 3 + c];
          squared += (value - other) * (value - other);
          ++n;
        }
      }
    }
  }
  // All pixels except a border are compared. The remaining difference is JPEG noise (quality 74 here) and double
  // interpolation.
  EXPECT_GT(n, 5u * 530 * 946 * 3 * 95 / 100);
  const double psnr = 10 * std::log10(255.0 * 255.0 * static_cast<double>(n) / squared);
  RecordProperty("psnr", std::to_string(psnr));
  EXPECT_GT(psnr, 38);
}

}  // namespace
}  // namespace b3dgs
