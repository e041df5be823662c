#include "scene/colmap/colmap.h"

#include <gtest/gtest.h>

#include <cstdlib>

#include "core/check.h"
#include "support/expect_error.h"
#include "support/files.h"
#include "support/sample_model.h"
#include "support/temp_dir.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using test::bytes_of;
using test::read_bytes;
using test::sample_model;
using test::TempDir;
using test::write_bytes;

void expect_equal(const ColmapModel& a, const ColmapModel& b) {
  ASSERT_EQ(a.cameras.size(), b.cameras.size());
  for (const auto& [id, camera] : a.cameras) {
    const ColmapCamera& other = b.cameras.at(id);
    EXPECT_EQ(camera.id, other.id);
    EXPECT_EQ(camera.model, other.model);
    EXPECT_EQ(camera.width, other.width);
    EXPECT_EQ(camera.height, other.height);
    EXPECT_EQ(camera.params, other.params);
  }
  ASSERT_EQ(a.images.size(), b.images.size());
  for (std::size_t i = 0; i < a.images.size(); ++i) {
    EXPECT_EQ(a.images[i].id, b.images[i].id);
    EXPECT_EQ(a.images[i].quat, b.images[i].quat);
    EXPECT_EQ(a.images[i].translation, b.images[i].translation);
    EXPECT_EQ(a.images[i].camera_id, b.images[i].camera_id);
    EXPECT_EQ(a.images[i].name, b.images[i].name);
  }
  ASSERT_EQ(a.points.size(), b.points.size());
  for (std::size_t i = 0; i < a.points.size(); ++i) {
    EXPECT_EQ(a.points[i].id, b.points[i].id);
    EXPECT_EQ(a.points[i].position, b.points[i].position);
    EXPECT_EQ(a.points[i].color, b.points[i].color);
    EXPECT_EQ(a.points[i].error, b.points[i].error);
  }
}

class ColmapRoundTrip : public testing::TestWithParam<ColmapFormat> {};

TEST_P(ColmapRoundTrip, ReadsBackEveryValue) {
  TempDir folder;
  write_colmap_model(folder.path(), sample_model(), GetParam());
  EXPECT_EQ(colmap_format(folder.path()), GetParam());
  EXPECT_EQ(count_colmap_images(folder.path()), 2u);
  expect_equal(read_colmap_model(folder.path()), sample_model());
}

TEST_P(ColmapRoundTrip, KeepsObservationsOnRequest) {
  TempDir folder;
  ColmapModel model = sample_model();
  const bool is_text = GetParam() == ColmapFormat::kText;
  model.images[0].points_2d = is_text ? "1.5 2.5 7" : std::string(3 * 24, '\x3f');
  model.points[0].track = is_text ? "1 0 2 5" : std::string(2 * 8, '\1');
  write_colmap_model(folder.path(), model, GetParam());
  const ColmapModel read = read_colmap_model(folder.path(), Observations::kAll);
  expect_equal(read, model);
  EXPECT_EQ(read.images[0].points_2d, model.images[0].points_2d);
  EXPECT_EQ(read.images[1].points_2d, "");
  EXPECT_EQ(read.points[0].track, model.points[0].track);
  EXPECT_EQ(read_colmap_model(folder.path()).points[0].track, "");
}

TEST(TransformColmap, MovesCamerasWithThePointsThatTheySee) {
  ColmapModel model = sample_model();
  const ColmapModel before = model;
  const Similarity to{3, rotation_from_quaternion({0.5, 0.5, -0.1, 0.7}), {100, -200, 50}};
  transform(to, model);
  for (std::size_t i = 0; i < model.images.size(); ++i) {
    const auto in_camera = [](const ColmapImage& image, const std::array<double, 3>& x) {
      std::array<double, 3> at = rotated(rotation_from_quaternion(image.quat), x);
      for (std::size_t axis = 0; axis < 3; ++axis) at[axis] += image.translation[axis];
      return at;
    };
    for (std::size_t k = 0; k < model.points.size(); ++k) {
      const auto was = in_camera(before.images[i], before.points[k].position);
      const auto is = in_camera(model.images[i], model.points[k].position);
      for (std::size_t axis = 0; axis < 3; ++axis) EXPECT_NEAR(is[axis], 3 * was[axis], 1e-9);
    }
    EXPECT_LT(distance(center_of(model.images[i]), to(center_of(before.images[i]))), 1e-9);
  }
}

TEST_P(ColmapRoundTrip, IsAcceptedByColmap) {
  if (std::system("colmap help > /dev/null 2>&1") != 0) GTEST_SKIP() << "colmap is not installed";
  TempDir folder;
  write_colmap_model(folder.path(), sample_model(), GetParam());
  const fs::path log = folder / "log";
  const std::string command = "colmap model_analyzer --path " + folder.path().string() + " > " + log.string() + " 2>&1";
  ASSERT_EQ(std::system(command.c_str()), 0) << read_bytes(log);
  const std::string output = read_bytes(log);
  EXPECT_NE(output.find("Cameras: 2"), std::string::npos) << output;
  EXPECT_NE(output.find("Registered images: 2"), std::string::npos) << output;
  EXPECT_NE(output.find("Points: 2"), std::string::npos) << output;
}

INSTANTIATE_TEST_SUITE_P(Formats, ColmapRoundTrip, testing::Values(ColmapFormat::kBinary, ColmapFormat::kText),
                         [](const auto& info) { return info.param == ColmapFormat::kBinary ? "Binary" : "Text"; });

TEST(ColmapWriter, BinaryCamerasHaveColmapsLayout) {
  TempDir folder;
  ColmapModel model;
  model.cameras[9] = {9, CameraModel::kSimplePinhole, 4, 3, {1.5, 2, 2.5}};
  write_colmap_model(folder.path(), model, ColmapFormat::kBinary);
  EXPECT_EQ(read_bytes(folder / "cameras.bin"), bytes_of<std::uint64_t>(1) + bytes_of<std::uint32_t>(9) +
                                                    bytes_of<std::int32_t>(0) + bytes_of<std::uint64_t>(4) +
                                                    bytes_of<std::uint64_t>(3) + bytes_of(1.5) + bytes_of(2.0) +
                                                    bytes_of(2.5));
}

TEST(ColmapReader, SkipsObservationsAndTracks) {
  TempDir folder;
  write_colmap_model(folder.path(), sample_model(), ColmapFormat::kBinary);
  std::string image = bytes_of<std::uint64_t>(2);
  for (std::uint32_t id : {1u, 2u}) {
    image += bytes_of(id);
    for (double value : {1., 0., 0., 0., 0., 0., 5.}) image += bytes_of(value);
    image += bytes_of<std::uint32_t>(7) + (id == 1 ? "x.png" : "y.png") + std::string(1, '\0');
    image += bytes_of<std::uint64_t>(40000) + std::string(40000 * 24, '\x55');  // more than the reader buffers
  }
  write_bytes(folder / "images.bin", image);
  std::string point = bytes_of<std::uint64_t>(1) + bytes_of<std::uint64_t>(5);
  for (double value : {1., 2., 3.}) point += bytes_of(value);
  point += std::string("\x0a\x14\x1e") + bytes_of(0.25) + bytes_of<std::uint64_t>(2) + std::string(16, '\x01');
  write_bytes(folder / "points3D.bin", point);
  const ColmapModel model = read_colmap_model(folder.path());
  ASSERT_EQ(model.images.size(), 2u);
  EXPECT_EQ(model.images[1].name, "y.png");
  EXPECT_EQ(model.images[1].translation[2], 5);
  ASSERT_EQ(model.points.size(), 1u);
  EXPECT_EQ(model.points[0].color[1], 20);
  EXPECT_EQ(model.points[0].error, 0.25);
  EXPECT_TRUE(model.points[0].image_ids.empty());
  const ColmapModel with_tracks = read_colmap_model(folder.path(), Observations::kTracks);
  EXPECT_EQ(with_tracks.points.at(0).image_ids, (std::vector<std::uint32_t>{0x01010101, 0x01010101}));
}

TEST(ColmapReader, ReadsTextAsOtherProgramsWriteIt) {
  TempDir folder;
  write_bytes(folder / "cameras.txt",
              "# Number of cameras: 99\n 0 PINHOLE 64 48 50 50 32 24 ");  // no newline at the end
  write_bytes(folder / "images.txt",
              "# comment\n\n5, 1, 0, 0, 0, 0, 0, +2.5e0, 0, left/a, b.png\n\n"
              "\t4 1 0 0 0 0 0 3 0 c.png\r\n  718.0 54.0 -1 706.0 56.0 1 \r\n"
              "6 1 0 0 0 0 0 1 0 last.png");
  write_bytes(folder / "points3D.txt",
              "\xEF\xBB\xBF"
              "0 1 2 3 4 5 6 0.5 0 0 1 0 \n 1 1 2 3 4 5 255 -1\n");
  const ColmapModel model = read_colmap_model(folder.path());
  EXPECT_EQ(model.cameras.at(0).params, (std::vector<double>{50, 50, 32, 24}));
  ASSERT_EQ(model.images.size(), 3u);
  EXPECT_EQ(model.images[0].id, 5u);
  EXPECT_EQ(model.images[0].name, "left/a, b.png");
  EXPECT_EQ(model.images[0].translation[2], 2.5);
  EXPECT_EQ(model.images[1].name, "c.png");
  EXPECT_EQ(model.images[2].name, "last.png");
  ASSERT_EQ(model.points.size(), 2u);
  EXPECT_EQ(model.points[1].color[2], 255);
  const ColmapModel with_tracks = read_colmap_model(folder.path(), Observations::kTracks);
  EXPECT_EQ(with_tracks.points.at(0).image_ids, (std::vector<std::uint32_t>{0, 1}));
  EXPECT_TRUE(with_tracks.points.at(1).image_ids.empty());
  write_bytes(folder / "points3D.txt", "0 1 2 3 4 5 6 0.5 0 0 1 \n");
  EXPECT_EQ(read_colmap_model(folder.path()).points.size(), 1u);
  EXPECT_TRUE(test::fails_with<InputError>({"points3D.txt", "the index of a 2D point"},
                                           [&] { read_colmap_model(folder.path(), Observations::kTracks); }));
}

TEST(ColmapReader, IgnoresRigsAndFramesAndPrefersBinary) {
  TempDir folder;
  write_colmap_model(folder.path(), sample_model(), ColmapFormat::kBinary);
  write_bytes(folder / "rigs.bin", "anything");
  write_bytes(folder / "frames.bin", "anything");
  write_bytes(folder / "cameras.txt", "not read");
  expect_equal(read_colmap_model(folder.path()), sample_model());
}

TEST(ColmapReader, ReadsTextWhereBinaryIsIncomplete) {
  TempDir folder;
  write_colmap_model(folder.path(), sample_model(), ColmapFormat::kText);
  write_bytes(folder / "cameras.bin", "left over");
  expect_equal(read_colmap_model(folder.path()), sample_model());
}

TEST(CameraModels, HaveColmapsNamesAndParameterCounts) {
  // Unsupported models have 0 parameters here.
  const std::vector<std::pair<const char*, int>> expected{{"SIMPLE_PINHOLE", 3},
                                                          {"PINHOLE", 4},
                                                          {"SIMPLE_RADIAL", 4},
                                                          {"RADIAL", 5},
                                                          {"OPENCV", 8},
                                                          {"OPENCV_FISHEYE", 8},
                                                          {"FULL_OPENCV", 12},
                                                          {"FOV", 5},
                                                          {"SIMPLE_RADIAL_FISHEYE", 4},
                                                          {"RADIAL_FISHEYE", 5},
                                                          {"THIN_PRISM_FISHEYE", 12},
                                                          {"RAD_TAN_THIN_PRISM_FISHEYE", 0},
                                                          {"SIMPLE_DIVISION", 4},
                                                          {"DIVISION", 5},
                                                          {"SIMPLE_FISHEYE", 3},
                                                          {"FISHEYE", 4},
                                                          {"EUCM", 6},
                                                          {"EQUIRECTANGULAR", 2}};
  for (std::size_t id = 0; id < expected.size(); ++id) {
    if (expected[id].second == 0) {
      EXPECT_TRUE(test::fails_with<InputError>({"cameras.txt", expected[id].first, "image_undistorter"},
                                               [&] { camera_model_from_name(expected[id].first, "cameras.txt"); }));
      continue;
    }
    const auto model = static_cast<CameraModel>(id);
    EXPECT_STREQ(camera_model_name(model), expected[id].first);
    EXPECT_EQ(camera_model_param_count(model), expected[id].second);
    EXPECT_EQ(camera_model_from_id(static_cast<int>(id), ""), model);
    EXPECT_EQ(camera_model_from_name(expected[id].first, ""), model);
  }
}

}  // namespace
}  // namespace b3dgs
