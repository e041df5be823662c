// Damaged models are rejected with an error that names the file, the place and the expected value.
#include <gtest/gtest.h>

#include <cmath>

#include "core/check.h"
#include "scene/colmap/colmap.h"
#include "support/expect_error.h"
#include "support/files.h"
#include "support/sample_model.h"
#include "support/temp_dir.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using test::bytes_of;
using test::fails_with;
using test::read_bytes;
using test::sample_model;
using test::TempDir;
using test::write_bytes;

class DamagedModel : public testing::Test {
 protected:
  void write(const ColmapModel& model, ColmapFormat format = ColmapFormat::kBinary) {
    write_colmap_model(folder_.path(), model, format);
  }
  std::string file(const char* name) const { return (folder_ / name).string(); }
  std::string content(const char* name) const { return read_bytes(folder_ / name); }
  void replace(const char* name, const std::string& bytes) { write_bytes(folder_ / name, bytes); }
  testing::AssertionResult refuses(std::initializer_list<std::string> parts) {
    return fails_with<InputError>(parts, [this] { read_colmap_model(folder_.path()); });
  }
  // Checks that this image is left out, but not the other one.
  testing::AssertionResult leaves_out(const std::string& name, std::initializer_list<std::string> parts) {
    const ColmapModel model = read_colmap_model(folder_.path());
    if (model.images.size() != 1 || model.left_out.size() != 1 || model.left_out[0].name != name) {
      return testing::AssertionFailure() << model.images.size() << " images, " << model.left_out.size() << " left out";
    }
    for (const std::string& part : parts) {
      if (model.left_out[0].reason.find(part) != std::string::npos) continue;
      return testing::AssertionFailure() << "\"" << part << "\" is not in: " << model.left_out[0].reason;
    }
    return testing::AssertionSuccess();
  }
  TempDir folder_;
};

constexpr const char* kSecond = "b/second image.png";  // of camera 7

TEST_F(DamagedModel, NamesAFolderWithoutAModel) {
  EXPECT_TRUE(refuses({folder_.path().string(), "no COLMAP model found"}));
}

TEST_F(DamagedModel, NamesTheMissingFile) {
  write(sample_model());
  fs::remove(folder_ / "points3D.bin");
  EXPECT_TRUE(refuses({file("points3D.bin"), "file not found"}));
}

TEST_F(DamagedModel, RejectsEveryTruncationOfEveryBinaryFile) {
  for (const char* name : {"cameras.bin", "images.bin", "points3D.bin"}) {
    write(sample_model());
    const std::string whole = content(name);
    for (std::size_t length = 0; length < whole.size(); ++length) {
      replace(name, whole.substr(0, length));
      ASSERT_TRUE(refuses({file(name)})) << name << " cut to " << length << " of " << whole.size() << " bytes";
    }
  }
}

TEST_F(DamagedModel, NamesTheRecordInWhichAFileEnds) {
  write(sample_model());
  const std::string whole = content("images.bin");
  replace("images.bin", whole.substr(0, whole.size() - 3));
  EXPECT_TRUE(refuses({file("images.bin"), "in image 2 of 2", "expected 3 more bytes", "truncated"}));
}

TEST_F(DamagedModel, RejectsTruncatedPointsFile) {
  ColmapModel model = sample_model();
  model.points.resize(1);
  write(model);
  // The track should have two elements and has one.
  std::string bytes = content("points3D.bin");
  bytes.replace(bytes.size() - 8, 8, bytes_of<std::uint64_t>(2));
  replace("points3D.bin", bytes + std::string(8, '\1'));
  EXPECT_TRUE(refuses({file("points3D.bin"), "2 track elements", "found 8 bytes"}));
}

TEST_F(DamagedModel, RejectsCountsLargerThanTheFileBeforeAllocating) {
  for (const char* name : {"cameras.bin", "images.bin", "points3D.bin"}) {
    write(sample_model());
    std::string bytes = content(name);
    bytes.replace(0, 8, bytes_of<std::uint64_t>(1ull << 60));
    replace(name, bytes);
    EXPECT_TRUE(refuses({file(name), "1152921504606846976", "truncated, damaged"}));
  }
}

TEST_F(DamagedModel, RejectsBytesAfterTheLastRecord) {
  for (const char* name : {"cameras.bin", "images.bin", "points3D.bin"}) {
    write(sample_model());
    replace(name, content(name) + "xyz");
    EXPECT_TRUE(refuses({file(name), "3 bytes follow after the last record"}));
  }
}

TEST_F(DamagedModel, RejectsAnUnknownCameraModelByNumber) {
  write(sample_model());
  std::string bytes = content("cameras.bin");
  bytes.replace(8 + 4, 4, bytes_of<std::int32_t>(42));
  replace("cameras.bin", bytes);
  EXPECT_TRUE(refuses({file("cameras.bin"), "camera 3", "unknown camera model 42"}));
}

TEST_F(DamagedModel, NamesAnUnsupportedCameraModelAndTheRemedy) {
  write(sample_model());
  std::string bytes = content("cameras.bin");
  bytes.replace(8 + 4, 4, bytes_of<std::int32_t>(11));
  replace("cameras.bin", bytes);
  EXPECT_TRUE(refuses({file("cameras.bin"), "camera 3", "RAD_TAN_THIN_PRISM_FISHEYE", "image_undistorter"}));
}

TEST_F(DamagedModel, LeavesOutImagesOfCamerasThatAreNotFinite) {
  ColmapModel model = sample_model();
  model.cameras[7].params[2] = NAN;
  write(model);
  EXPECT_TRUE(leaves_out(kSecond, {file("cameras.bin"), "camera 7", "PINHOLE", "fx, fy, cx, cy", "nan"}));
  model.cameras[7].params = {0, 50, 31, 25};
  write(model);
  EXPECT_TRUE(leaves_out(kSecond, {file("cameras.bin"), "camera 7: expected focal lengths above 0"}));
  model.cameras[3].params[0] = INFINITY;
  write(model);
  EXPECT_TRUE(refuses({"camera 7: expected focal lengths above 0"})) << "the first image's";
}

TEST_F(DamagedModel, ReadsWhatOtherProgramsWriteForNan) {
  write(sample_model(), ColmapFormat::kText);
  replace("cameras.txt", "7 PINHOLE 64 48 -nan(ind) nan 32 24\n3 PINHOLE 640 480 50 50 32 24\n");
  EXPECT_TRUE(leaves_out(kSecond, {file("cameras.txt"), "camera 7", "nan"}));
  replace("cameras.txt", "7 PINHOLE 64 48 50 -1.#IND 32 24\n3 PINHOLE 640 480 50 50 32 24\n");
  EXPECT_TRUE(leaves_out(kSecond, {file("cameras.txt"), "camera 7", "nan"}));
  replace("cameras.txt", "7 PINHOLE 64 48 50 50 32 24\n");
  replace("images.txt", "1 1 0 0 0 0 1.#QNAN 1 7 a.png\n1.5 2e1 -1 -1.#IND00 1.#INF 17\n2 1 0 0 0 0 0 1 7 b.png\n\n");
  EXPECT_TRUE(leaves_out("a.png", {file("images.txt"), "image 1", "translation", "nan"}));
  for (const char* nan : {"1.#QNAN", "-1.#IND", "-1.#IND000", "-nan(ind)", "1.#INF", "NaN"}) {
    replace("points3D.txt", std::string("1 0 0 ") + nan + " 1 2 3 0\n2 0 0 1 1 2 3 0\n");
    const ColmapModel model = read_colmap_model(folder_.path());
    ASSERT_EQ(model.points.size(), 1u) << nan;
    EXPECT_EQ(model.points[0].id, 2u);
    EXPECT_NE(model.left_out_points.find("point 1: "), std::string::npos) << model.left_out_points;
  }
}

TEST_F(DamagedModel, LeavesOutImagesOfACameraWithoutPixels) {
  ColmapModel model = sample_model();
  model.cameras[7].height = 0;
  write(model);
  EXPECT_TRUE(leaves_out(kSecond, {"camera 7", "64 x 0"}));
}

TEST_F(DamagedModel, LeavesOutPosesThatAreNotFinite) {
  for (const auto format : {ColmapFormat::kText, ColmapFormat::kBinary}) {
    ColmapModel model = sample_model();
    model.images[0].translation[1] = NAN;
    write(model, format);
    EXPECT_TRUE(leaves_out(kSecond, {"image 20 (b/second image.png)", "translation", "nan"}));
    model.images[1].quat[2] = -INFINITY;
    write(model, format);
    EXPECT_TRUE(refuses({"image 20 (b/second image.png)", "translation", "nan"})) << "the first of all";
  }
}

TEST_F(DamagedModel, LeavesOutAQuaternionOfLengthZero) {
  ColmapModel model = sample_model();
  model.images[1].quat = {0, 0, 0, 0};
  write(model);
  EXPECT_TRUE(leaves_out("a.png", {"image 0 (a.png)", "found length 0"}));
}

TEST_F(DamagedModel, LeavesOutPosesThatAreTooLarge) {
  ColmapModel model = sample_model();
  model.images[1].quat = {1e200, 0, 0, 0};  // finite, but its square is infinite
  write(model);
  EXPECT_TRUE(leaves_out("a.png", {file("images.bin"), "image 0 (a.png)", "quaternion of length 1, found length inf"}));
  model = sample_model();
  model.images[0].translation[2] = -1e300;
  write(model);
  EXPECT_TRUE(leaves_out(kSecond, {file("images.bin"), "image 20", "-1e+300", "1e+12"}));
}

TEST_F(DamagedModel, RejectsNamesThatPointOutsideTheImageFolder) {
  for (const char* name : {"../a.png", "b/../../a.png", "/etc/a.png", "..\\a.png"}) {
    ColmapModel model = sample_model();
    model.images[1].name = name;
    write(model);
    EXPECT_TRUE(refuses({file("images.bin"), "image 0", "inside the image folder"})) << name;
  }
  ColmapModel model = sample_model();
  model.images[1].name = "b..c/a..png";  // no parent folder
  write(model);
  EXPECT_EQ(read_colmap_model(folder_.path()).images[1].name, "b..c/a..png");
}

TEST_F(DamagedModel, RejectsNamesThatCouldControlATerminal) {
  ColmapModel model = sample_model();
  model.images[1].name = "\x1b[31m.png";
  write(model);
  EXPECT_TRUE(refuses({file("images.bin"), "image 0 (?[31m.png)", "control characters"}));
  model.images[1].name =
      "\xc2\x9b"
      "31m.png";  // CSI as one character
  write(model);
  EXPECT_TRUE(refuses({file("images.bin"), "image 0 (?31m.png)", "control characters"}));
  model.images[1].name =
      "f\xc3\xbc"
      "chse.png";  // UTF-8
  write(model);
  EXPECT_EQ(read_colmap_model(folder_.path()).images[1].name,
            "f\xc3\xbc"
            "chse.png");
}

TEST_F(DamagedModel, KeepsErrorsToOneLineWhateverTheName) {
  ColmapModel model = sample_model();
  model.images[1].name = "a\nb\x1b[31m.png";
  write(model);
  EXPECT_TRUE(refuses({"image 0 (a?b?[31m.png)", "control characters"}));
}

TEST_F(DamagedModel, NamesTheMissingCameraOfAnImage) {
  ColmapModel model = sample_model();
  model.images[1].camera_id = 12;
  write(model);
  EXPECT_TRUE(refuses({file("images.bin"), "image 0 (a.png)", "camera 12", "not in the cameras file"}));
}

TEST_F(DamagedModel, RejectsDuplicateIdsAndNames) {
  ColmapModel model = sample_model();
  model.images[1].id = 20;
  write(model);
  EXPECT_TRUE(refuses({file("images.bin"), "two images have the ID 20"}));
  model = sample_model();
  model.images[1].name = model.images[0].name;
  write(model);
  EXPECT_TRUE(refuses({"two images have the name b/second image.png"}));
  model = sample_model();
  model.points[1].id = model.points[0].id;
  write(model);
  EXPECT_TRUE(refuses({file("points3D.bin"), "two points have the ID 0"}));
  write(sample_model());
  std::string bytes = content("cameras.bin");
  const std::size_t second = 8 + 24 + 8 * 8;  // after the OPENCV camera 3
  bytes.replace(second, 4, bytes_of<std::uint32_t>(3));
  replace("cameras.bin", bytes);
  EXPECT_TRUE(refuses({file("cameras.bin"), "two cameras have the ID 3"}));
}

TEST_F(DamagedModel, LeavesOutPointsThatAreNotFinite) {
  for (const auto format : {ColmapFormat::kText, ColmapFormat::kBinary}) {
    for (const auto& [value, text] :
         {std::pair<double, const char*>{NAN, "nan"}, {INFINITY, "inf"}, {1e300, "1e+300"}}) {
      ColmapModel model = sample_model();
      model.points[0].position[2] = value;
      write(model, format);
      const ColmapModel read = read_colmap_model(folder_.path());
      ASSERT_EQ(read.points.size(), 1u);
      EXPECT_EQ(read.points[0].id, 9007199254740993u);
      EXPECT_EQ(read.left_out_points, file(format == ColmapFormat::kText ? "points3D.txt" : "points3D.bin") +
                                          ": point 0: expected coordinates of at most 1e+12, found " + text +
                                          "; 1 of 2 points are left out");
      model.points[1].position[0] = value;
      write(model, format);
      EXPECT_TRUE(refuses({"point 0", text, "reconstruct the scene again"})) << "all of them";
      fs::remove(folder_ / "cameras.txt");  // otherwise both formats exist
    }
  }
}

TEST_F(DamagedModel, NamesTheLineOfAWrongNumber) {
  write(sample_model(), ColmapFormat::kText);
  replace("points3D.txt", "# comment\n1 0 0 0 1 2 3 0\n2 0 zero 0 1 2 3 0\n");
  EXPECT_TRUE(refuses({file("points3D.txt") + ":3:", "position x, y, z", "\"zero\""}));
  replace("points3D.txt", "1 0 0 0 1 2 256 0\n");
  EXPECT_TRUE(refuses({file("points3D.txt") + ":1:", "0 to 255", "\"256\""}));
  replace("points3D.txt", "1 0 0 0 1 2\n");
  EXPECT_TRUE(refuses({file("points3D.txt") + ":1:", "found the end of the line"}));
}

TEST_F(DamagedModel, NamesTheLineWithTheWrongNumberOfCameraParameters) {
  write(sample_model(), ColmapFormat::kText);
  replace("cameras.txt", "7 PINHOLE 64 48 50 50 32\n3 PINHOLE 64 48 50 50 32 24\n");
  EXPECT_TRUE(refuses({file("cameras.txt") + ":1:", "the 4 parameters fx, fy, cx, cy of PINHOLE"}));
  replace("cameras.txt", "3 PINHOLE 64 48 50 50 32 24\n7 PINHOLE 64 48 50 50 32 24 0.5\n");
  EXPECT_TRUE(refuses({file("cameras.txt") + ":2:", "expected only the 4 parameters", "0.5"}));
}

TEST_F(DamagedModel, RejectsAnUnknownCameraModelByName) {
  write(sample_model(), ColmapFormat::kText);
  replace("cameras.txt", "7 SPHERE 64 48 50 50 32\n");
  EXPECT_TRUE(refuses({file("cameras.txt") + ":1:", "unknown camera model \"SPHERE\""}));
  replace("cameras.txt", "7 RAD_TAN_THIN_PRISM_FISHEYE 64 48\n");
  EXPECT_TRUE(refuses({file("cameras.txt") + ":1:", "RAD_TAN_THIN_PRISM_FISHEYE", "image_undistorter"}));
}

TEST_F(DamagedModel, RejectsTextImagesWithoutTheirLineOf2dPoints) {
  write(sample_model(), ColmapFormat::kText);
  replace("images.txt", "1 1 0 0 0 0 0 1 7 a.png\n2 1 0 0 0 0 0 1 7 b.png\n");
  EXPECT_TRUE(refuses({file("images.txt") + ":2:", "2D points of image 1", "b.png"}));
  // Names can be numbers.
  replace("images.txt", "1 1 0 0 0 0 0 1 7 0000\n2 1 0 0 0 0 0 1 7 0001\n");
  EXPECT_TRUE(refuses({file("images.txt") + ":2:", "2D points of image 1", "found 10 numbers; add a second line"}));
  replace("images.txt", "1 1 0 0 0 0 0 1 7 0000\n1.5 2e1 -1 nan -nan(ind) 17\n2 1 0 0 0 0 0 1 7 0001\n\n");
  EXPECT_EQ(read_colmap_model(folder_.path()).images.size(), 2u);
  replace("images.txt", "1 1 0 0 0 0 0 1 7\n\n");
  EXPECT_TRUE(refuses({file("images.txt") + ":1:", "expected the image's name"}));
}

}  // namespace
}  // namespace b3dgs
