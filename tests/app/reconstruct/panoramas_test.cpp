#include "app/reconstruct/panoramas.h"

#include <gtest/gtest.h>

#include <chrono>
#include <cmath>

#include "app/reconstruct/fake_programs.h"
#include "app/reconstruct/reconstruct.h"
#include "core/vec.h"
#include "scene/scene.h"
#include "support/expect_error.h"
#include "support/files.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using test::fails_with;
using test::FakePrograms;
using test::TempDir;
using test::write_photographs;
using Matrix = std::array<double, 9>;

Matrix product(const Matrix& a, const Matrix& b) {
  Matrix c{};
  for (std::size_t i = 0; i < 9; ++i) {
    for (std::size_t k = 0; k < 3; ++k) c[i] += a[i / 3 * 3 + k] * b[3 * k + i % 3];
  }
  return c;
}

/// Returns a rotation about one of the axes x, y, z.
Matrix turn(std::size_t axis, double degrees) {
  const std::size_t a = (axis + 1) % 3, b = (axis + 2) % 3;
  Matrix matrix{1, 0, 0, 0, 1, 0, 0, 0, 1};
  matrix[4 * a] = matrix[4 * b] = std::cos(degrees * kDegree);
  matrix[3 * b + a] = std::sin(degrees * kDegree);
  matrix[3 * a + b] = -matrix[3 * b + a];
  return matrix;
}

Pose pose_at(const Matrix& rotation, const std::array<double, 3>& center) {
  Pose pose{rotation, {}};
  for (std::size_t i = 0; i < 9; ++i) pose.translation[i / 3] -= rotation[i] * center[i % 3];
  return pose;
}

Pose pose_of(const ColmapImage& image) {
  return {rotation_from_quaternion(image.quat), image.translation};
}

std::array<double, 3> center_of(const Pose& pose) {
  Camera camera;
  camera.cam_from_world = pose;
  return camera.center();
}

double degrees_between(const Matrix& a, const Matrix& b) {
  double trace = 0;
  for (std::size_t i = 0; i < 9; ++i) trace += a[i] * b[i];
  return std::acos(std::min(1.0, (trace - 1) / 2)) / kDegree;
}

/// Panoramas a.png, b.png, ... around points at a distance of about 5, and the model of their faces that COLMAP would
/// make without errors.
struct Truth {
  explicit Truth(std::size_t n) {
    for (std::size_t i = 0; i < n; ++i) {
      panoramas.names.push_back(std::string(1, static_cast<char>('a' + i)) + ".png");
      panoramas.sizes.push_back(i == 0 ? ImageSize{16, 8} : ImageSize{32, 16});
      const double angle = 360.0 * static_cast<double>(i) / static_cast<double>(n);
      const Matrix rotation = product(turn(0, 7), product(turn(2, -4), turn(1, angle)));
      poses.push_back(pose_at(rotation, {std::cos(angle * kDegree), 0.1 * static_cast<double>(i), 1}));
    }
    const std::vector<Camera> cameras = panorama_faces(panoramas.sizes);
    n_faces = cameras.size();
    faces.cameras[1] = {1, CameraModel::kPinhole, 8, 8, {4, 4, 4, 4}};
    for (std::size_t i = 0; i < n; ++i) {
      for (std::size_t face = 0; face < n_faces; ++face) {
        ColmapImage image;
        image.id = static_cast<std::uint32_t>(faces.images.size() + 1);
        image.camera_id = 1;
        image.name = panoramas.names[i] + "/" + std::to_string(face) + ".jpg";
        faces.images.push_back(image);
        set_face(i, face, cameras[face].cam_from_world.rotation, center_of(poses[i]));
      }
    }
    for (std::size_t k = 0; k < 24; ++k) {
      ColmapPoint point;
      point.id = k + 1;
      const double angle = 15.0 * static_cast<double>(k) * kDegree;
      point.position = {5 * std::cos(angle), 0, 5 * std::sin(angle)};
      for (std::size_t i = 0; i < n; ++i) point.image_ids.push_back(id_of(i, k % n_faces));
      faces.points.push_back(point);
    }
  }
  std::uint32_t id_of(std::size_t panorama, std::size_t face) const {
    return static_cast<std::uint32_t>(n_faces * panorama + face + 1);
  }
  /// `from_panorama`: the face's rotation in its panorama.
  void set_face(std::size_t panorama, std::size_t face, const Matrix& from_panorama,
                const std::array<double, 3>& center) {
    ColmapImage& image = faces.images[n_faces * panorama + face];
    const Pose pose = pose_at(product(from_panorama, poses[panorama].rotation), center);
    image.quat = quaternion_from_rotation(pose.rotation);
    image.translation = pose.translation;
  }
  void expect_joined(double degrees, double distance) const {
    const ColmapModel model = join_faces(faces, panoramas);
    ASSERT_EQ(model.images.size(), poses.size());
    for (std::size_t i = 0; i < poses.size(); ++i) {
      const Pose pose = pose_of(model.images[i]);
      EXPECT_EQ(model.images[i].name, panoramas.names[i]);
      EXPECT_LE(degrees_between(pose.rotation, poses[i].rotation), degrees) << i;
      for (std::size_t axis = 0; axis < 3; ++axis) {
        EXPECT_NEAR(center_of(pose)[axis], center_of(poses[i])[axis], distance) << i;
      }
    }
  }

  CheckedPhotographs panoramas;
  std::vector<Pose> poses;
  std::size_t n_faces = 0;
  ColmapModel faces;
};

TEST(Panoramas, AreJoinedFromTheirFaces) {
  const Truth truth(6);
  truth.expect_joined(1e-5, 1e-9);
  const ColmapModel model = join_faces(truth.faces, truth.panoramas);
  ASSERT_EQ(model.cameras.size(), 2u) << "one for each size";
  const ColmapCamera& camera = model.cameras.at(model.images[1].camera_id);
  EXPECT_EQ(camera.model, CameraModel::kEquirectangular);
  EXPECT_EQ(camera.params, (std::vector<double>{32, 16}));
  EXPECT_EQ(model.points.size(), 24u);
  EXPECT_EQ(model.points[0].image_ids, (std::vector<std::uint32_t>{1, 2, 3, 4, 5, 6}));
}

TEST(Panoramas, ModelsOfOneSizeKeepTheirOrder) {
  const TempDir folder;
  const Truth truth(6);
  for (std::size_t i = 0; i < 6; ++i) {  // each without another panorama
    ColmapModel model = truth.faces;
    const auto first = model.images.begin() + static_cast<std::ptrdiff_t>(i * truth.n_faces);
    model.images.erase(first, first + static_cast<std::ptrdiff_t>(truth.n_faces));
    model.points.clear();
    write_colmap_model(folder / "models" / std::to_string(i), model, ColmapFormat::kBinary);
  }
  EXPECT_EQ(join_models(folder / "models", folder / "joined", truth.panoramas), 6u);
  for (std::size_t i = 0; i < 6; ++i) {
    const ColmapModel model = read_colmap_model(folder / "joined" / std::to_string(i));
    EXPECT_EQ(model.images.size(), 5u);
    for (const ColmapImage& image : model.images) EXPECT_NE(image.name, truth.panoramas.names[i]);
  }
}

TEST(Panoramas, TheFacesShowThemAndTheirCamerasAreThoseOfTheModel) {
  // The panorama has one bright column, left of its middle, which is in the middle of the left face.
  const TempDir folder;
  CheckedPhotographs panoramas{{"sub/a.png"}, {{128, 64}}, {}};
  Image8 image(128, 64, 3);
  for (std::size_t y = 0; y < 64; ++y) image.pixels[3 * (128 * y + 32)] = image.pixels[3 * (128 * y + 31)] = 255;
  write_image(folder / "sub/a.png", image);
  const std::vector<std::string> names = cut_panoramas(folder.path(), folder / "faces", panoramas, [](std::size_t) {});
  const std::vector<Camera> cameras = panorama_faces(panoramas.sizes);
  ASSERT_EQ(names.size(), cameras.size());
  for (std::size_t i = 0; i < names.size(); ++i) {
    const Image8 face = read_image(folder / "faces" / names[i], false);
    ASSERT_EQ(face.width, cameras[i].width);
    const auto middle = static_cast<std::size_t>(face.width) / 2;
    const bool looks_left = cameras[i].cam_from_world.rotation[6] < -0.9;  // along -x of the panorama
    EXPECT_EQ(face.pixels[3 * (middle * static_cast<std::size_t>(face.width) + middle)] > 100, looks_left) << i;
  }
}

TEST(Panoramas, FacesThatDisagreeAreDropped) {
  Truth truth(6);
  const std::vector<Camera> cameras = panorama_faces(truth.panoramas.sizes);
  const Matrix &first = cameras[0].cam_from_world.rotation, &second = cameras[1].cam_from_world.rotation;
  truth.set_face(1, 0, product(turn(1, 20), first), center_of(truth.poses[1]));
  truth.set_face(2, 1, second, {center_of(truth.poses[2])[0] + 2, 0, 0});
  truth.expect_joined(1e-5, 1e-9);
  // A point seen only by such a face and one of another panorama is unknown.
  truth.faces.points[0].image_ids = {truth.id_of(1, 0), truth.id_of(3, 0)};
  truth.faces.points[1].image_ids = {truth.id_of(1, 1), truth.id_of(3, 0)};
  const ColmapModel model = join_faces(truth.faces, truth.panoramas);
  ASSERT_EQ(model.points.size(), 23u);
  EXPECT_EQ(model.points[0].id, 2u);
}

TEST(Panoramas, SmallErrorsOfFacesAreAveraged) {
  Truth truth(6);
  const std::vector<Camera> cameras = panorama_faces(truth.panoramas.sizes);
  for (std::size_t face = 0; face < cameras.size(); ++face) {
    std::array<double, 3> center = center_of(truth.poses[4]);
    center[0] += face % 2 == 0 ? 0.05 : -0.05;
    truth.set_face(4, face, product(cameras[face].cam_from_world.rotation, turn(1, face % 2 == 0 ? 1 : -1)), center);
  }
  truth.expect_joined(1e-5, 1e-9);
}

TEST(Panoramas, OfTwoFacesThatDisagreeTheOneWithMorePointsCounts) {
  Truth truth(6);
  const Matrix rotation = panorama_faces(truth.panoramas.sizes)[0].cam_from_world.rotation;
  truth.set_face(0, 0, product(turn(0, 9), rotation), center_of(truth.poses[0]));
  truth.faces.images.erase(truth.faces.images.begin() + 2, truth.faces.images.begin() + 4);  // of panorama 0
  truth.faces.points[0].image_ids = {truth.id_of(0, 1), truth.id_of(1, 1)};  // instead of its first face
  truth.expect_joined(1e-5, 1e-9);
}

class ReconstructPanoramas : public testing::Test {
 protected:
  ReconstructPanoramas() {
    options_.input = (folder_ / "photos").string();
    options_.output = (folder_ / "scene").string();
    options_.camera_model = "EQUIRECTANGULAR";
    write_photographs(options_.input, 6, 32, 16);
    programs_.set_model(Truth(6).faces);
  }
  void make_scene() {
    programs_.forget_calls();
    warnings_.clear();
    result_ = reconstruct(options_, {}, nullptr, [&](const std::string& line) { warnings_.push_back(line); });
  }
  testing::AssertionResult fails(std::initializer_list<std::string> parts) {
    return fails_with<InputError>(parts, [&] { make_scene(); });
  }
  fs::path scene() const { return options_.output; }

  TempDir folder_;
  FakePrograms programs_;
  ReconstructOptions options_;
  ReconstructResult result_;
  std::vector<std::string> warnings_;
};

TEST_F(ReconstructPanoramas, MakesASceneOfPanoramas) {
  make_scene();
  EXPECT_TRUE(warnings_.empty());
  EXPECT_EQ(result_.n_photographs, 6u);
  EXPECT_EQ(result_.n_registered, 6u);
  EXPECT_EQ(result_.n_points, 24u);
  const ColmapModel model = read_colmap_model(scene() / "sparse/0");
  ASSERT_EQ(model.cameras.size(), 1u);
  EXPECT_EQ(model.cameras.begin()->second.model, CameraModel::kEquirectangular);
  EXPECT_TRUE(fs::exists(scene() / "images/f.png"));
  EXPECT_FALSE(fs::exists(scene() / "reconstruct/panoramas"));
  ASSERT_EQ(programs_.calls().size(), 3u);
  const std::string extract = programs_.calls()[0], map = programs_.calls()[2];
  for (const char* words : {"--ImageReader.camera_model PINHOLE --ImageReader.camera_params ", "reconstruct/faces ",
                            "--ImageReader.single_camera 1"}) {
    EXPECT_NE(extract.find(words), std::string::npos) << extract;
  }
  EXPECT_NE(map.find("--Mapper.ba_refine_focal_length 0 --Mapper.ba_refine_extra_params 0"), std::string::npos) << map;
  make_scene();
  EXPECT_TRUE(programs_.calls().empty()) << "nothing is done again";
  options_.matcher = "sequential";
  make_scene();
  ASSERT_EQ(programs_.calls().size(), 2u);
  EXPECT_NE(programs_.calls()[0].find("--SequentialMatching.overlap 20"), std::string::npos) << programs_.calls()[0];
}

TEST_F(ReconstructPanoramas, OtherPanoramasAreCutAgain) {
  make_scene();
  const fs::path face = scene() / "reconstruct/faces/b.png/0.jpg";
  const std::string before = test::read_bytes(face);
  ASSERT_FALSE(before.empty());
  fs::copy_file(folder_ / "photos/f.png", folder_ / "photos/b.png", fs::copy_options::overwrite_existing);
  fs::last_write_time(folder_ / "photos/b.png", fs::file_time_type::clock::now() + std::chrono::hours(1));
  make_scene();
  EXPECT_EQ(programs_.calls().size(), 3u);
  EXPECT_NE(test::read_bytes(face), before);
}

TEST_F(ReconstructPanoramas, EveryPhotographHasToBeOne) {
  write_photographs(folder_ / "photos/more", 1, 30, 16);
  EXPECT_TRUE(fails({"images/more/a.png: expected a panorama of 360 x 180 degrees, twice as wide as high",
                     "EQUIRECTANGULAR", "found 30 x 16 px", "leave it out"}));
  EXPECT_TRUE(programs_.calls().empty());
}

TEST_F(ReconstructPanoramas, AreNotTakenForPanoramasSilently) {
  options_.camera_model = "OPENCV";
  programs_.set_models({6});
  make_scene();
  ASSERT_EQ(warnings_.size(), 1u);
  EXPECT_NE(warnings_[0].find("--camera_model EQUIRECTANGULAR"), std::string::npos) << warnings_[0];
  EXPECT_FALSE(fs::exists(scene() / "reconstruct/faces"));
}

TEST_F(ReconstructPanoramas, TooFewRegisteredAreAnErrorAsEver) {
  ColmapModel faces = Truth(6).faces;
  faces.images.resize(4 * 3);
  programs_.set_model(faces);
  EXPECT_TRUE(fails({"only 3 of 6 photographs (50 %) are registered", "reconstruct/sparse"}));
  EXPECT_EQ(count_colmap_images(scene() / "reconstruct/sparse/0"), 3u);
}

}  // namespace
}  // namespace b3dgs
