// Cameras that keep the lens of their photographs.
#include "scene/cameras/camera_lens.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>

#include "core/check.h"
#include "core/vec.h"
#include "scene/colmap/colmap.h"
#include "scene/view_image.h"
#include "scene_folder.h"
#include "support/expect_error.h"

namespace b3dgs::test {
namespace {

Camera native(CameraModel model, std::vector<double> params, int width, int height) {
  ColmapCamera camera;
  camera.model = model;
  camera.width = static_cast<std::uint64_t>(width);
  camera.height = static_cast<std::uint64_t>(height);
  camera.params = std::move(params);
  return native_camera(camera_of(camera, "camera 1"), "camera 1");
}

/// Returns a lens of 80 x 60 px for every model that is not a pinhole.
std::map<std::string, Camera> native_cameras() {
  std::map<std::string, Camera> cameras;
  const std::map<CameraModel, std::vector<double>> params{
      {CameraModel::kSimpleRadial, {60, 41, 29, -0.1}},
      {CameraModel::kRadial, {60, 41, 29, -0.1, 0.02}},
      {CameraModel::kOpenCv, {60, 62, 41, 29, -0.1, 0.02, 0.003, -0.004}},
      {CameraModel::kFullOpenCv, {60, 62, 41, 29, -0.1, 0.02, 0.003, -0.004, 0.001, 0.02, 0.01, 0.001}},
      {CameraModel::kFov, {60, 62, 41, 29, 0.9}},
      {CameraModel::kSimpleDivision, {60, 41, 29, -0.2}},
      {CameraModel::kDivision, {60, 62, 41, 29, -0.2}},
      {CameraModel::kEucm, {60, 62, 41, 29, 0.6, 1.1}},
      {CameraModel::kSimpleFisheye, {20, 41, 29}},
      {CameraModel::kFisheye, {20, 21, 41, 29}},
      {CameraModel::kSimpleRadialFisheye, {20, 41, 29, 0.02}},
      {CameraModel::kRadialFisheye, {20, 41, 29, 0.02, -0.003}},
      {CameraModel::kOpenCvFisheye, {20, 21, 41, 29, 0.02, -0.004, 0.0005, -0.00002}},
      {CameraModel::kThinPrismFisheye, {30, 31, 41, 29, 0.02, -0.004, 0.002, -0.003, 0.0005, -0.00002, 0.001, -0.002}},
  };
  for (const auto& [model, values] : params) cameras[camera_model_name(model)] = native(model, values, 80, 60);
  cameras["EQUIRECTANGULAR"] = native(CameraModel::kEquirectangular, {80, 40}, 80, 40);
  return cameras;
}

TEST(CameraLens, CoversEveryModel) {
  // SIMPLE_PINHOLE and PINHOLE do not have a lens.
  EXPECT_EQ(native_cameras().size() + 2, supported_camera_models().size());
}

TEST(CameraLens, RaysArePutBackWhereTheyComeFrom) {
  for (const auto& [name, camera] : native_cameras()) {
    const LensRays rays(camera);
    int n_shown = 0;
    for (double y = 0.5; y < camera.height; y += 4.7) {
      for (double x = 0.5; x < camera.width; x += 4.3) {
        const auto ray = rays.at(x, y);
        if (!ray) continue;
        ++n_shown;
        const auto place = camera.image_of(*ray);
        ASSERT_TRUE(place) << name << " at " << x << ", " << y;
        EXPECT_NEAR(place->x, x, 1e-6) << name;
        EXPECT_NEAR(place->y, y, 1e-6) << name;
        EXPECT_NEAR(place->depth, has_radial_depth(camera.lens) ? 1 : (*ray)[2], 1e-12) << name;
      }
    }
    EXPECT_GT(n_shown, 150) << name;
  }
}

TEST(CameraLens, SeesWhatUndistortionReads) {
  for (const CameraModel model : {CameraModel::kFullOpenCv, CameraModel::kOpenCvFisheye}) {
    const bool is_fisheye = model == CameraModel::kOpenCvFisheye;
    ColmapCamera colmap;
    colmap.model = model;
    colmap.width = 80;
    colmap.height = 60;
    colmap.params = is_fisheye
                        ? std::vector<double>{20, 21, 41, 29, 0.02, -0.004, 0.0005, -0.00002}
                        : std::vector<double>{60, 62, 41, 29, -0.1, 0.02, 0.003, -0.004, 0.001, 0.02, 0.01, 0.001};
    const Camera camera = native_camera(camera_of(colmap, ""), "");
    for (const auto& [x, y] : {std::pair(0.0, 0.0), std::pair(0.3, -0.2), std::pair(-0.5, 0.3)}) {
      const auto [u, v] = distort(camera.lens, x, y);
      const auto place = camera.image_of({2 * x, 2 * y, 2});
      ASSERT_TRUE(place);
      EXPECT_NEAR(place->x, camera.fx * u + camera.cx, 1e-9);
      EXPECT_NEAR(place->y, camera.fy * v + camera.cy, 1e-9);
    }
  }
}

TEST(CameraLens, EndsBeyondTheCornersOrWhereTheFormulaFoldsOver) {
  // Corners at 50 px of 20 px per radian.
  const Camera wide = native(CameraModel::kSimpleFisheye, {20, 40, 30}, 80, 60);
  EXPECT_NEAR(wide.lens.max_angle, 1.15 * 2.5, 0.01);
  EXPECT_EQ(lens_mask(wide), nullptr);
  // theta - 0.15 theta^3 grows up to 85 degrees, where it is 0.99.
  const Camera folded = native(CameraModel::kSimpleRadialFisheye, {20, 40, 30, -0.15}, 80, 60);
  EXPECT_LT(folded.lens.max_angle, 86 * kDegree);
  EXPECT_GT(folded.lens.max_angle, 70 * kDegree);
  const auto mask = lens_mask(folded);
  ASSERT_NE(mask, nullptr);
  const auto at = [&](int x, int y) { return mask->pixels[static_cast<std::size_t>(80 * y + x)]; };
  EXPECT_EQ(at(40, 30), 255);
  EXPECT_EQ(at(40 + 17, 30), 255);
  EXPECT_EQ(at(40 + 22, 30), 0);
}

TEST(CameraLens, OfAPanoramaLeavesOutThePoles) {
  const Camera panorama = native(CameraModel::kEquirectangular, {720, 360}, 720, 360);
  const auto mask = lens_mask(panorama);
  ASSERT_NE(mask, nullptr);
  for (int row = 0; row < 360; ++row) {
    EXPECT_EQ(mask->pixels[static_cast<std::size_t>(720 * row)] == 0, row < 8 || row >= 352) << row;
  }
}

TEST(CameraLens, NamesModelsThatReadersKnow) {
  for (const auto& [name, camera] : native_cameras()) {
    const Camera same = native_camera(camera_of(to_colmap_camera(camera), ""), "");
    EXPECT_EQ(same.lens.kind, camera.lens.kind) << name;
    EXPECT_TRUE(std::equal(same.lens.k, same.lens.k + kLensCoefficients, camera.lens.k)) << name;
    EXPECT_EQ(same.lens.max_angle, camera.lens.max_angle) << name;
    EXPECT_EQ(same.fx, camera.fx) << name;
    EXPECT_EQ(same.cy, camera.cy) << name;
  }
}

TEST(CameraLens, APanoramaShowsWhatIsOnItsSeam) {
  for (int height = 1; height <= 2048; ++height) {
    const Camera panorama = native(CameraModel::kEquirectangular, {2.0 * height, 1.0 * height}, 2 * height, height);
    const auto place = panorama.image_of({0, 0, -1});
    ASSERT_TRUE(place) << height;
    EXPECT_LT(std::min(place->x, 2 * height - place->x), 1e-6);
  }
}

TEST(CameraLens, FacesShowWhatAPanoramaShows) {
  const Camera panorama = native(CameraModel::kEquirectangular, {256, 128}, 256, 128);
  Image8 image(256, 128, 3);
  for (std::size_t i = 0; i < image.pixels.size() / 3; ++i) {  // smooth across the seam
    const double longitude = (static_cast<double>(i % 256) + 0.5) * 360 / 256 * kDegree;
    image.pixels[3 * i] = static_cast<std::uint8_t>(std::lround(128 + 100 * std::cos(longitude)));
    image.pixels[3 * i + 1] = static_cast<std::uint8_t>(std::lround(128 + 100 * std::sin(longitude)));
    image.pixels[3 * i + 2] = static_cast<std::uint8_t>(i / 256);
  }
  const std::vector<Camera> faces = pinhole_faces(panorama);
  ASSERT_EQ(faces.size(), 6u);
  std::vector<int> n_shown(image.pixels.size() / 3, 0);
  for (const Camera& face : faces) {
    const Warped warped = warp_image(image, panorama, face);
    EXPECT_EQ(std::count(warped.valid.pixels.begin(), warped.valid.pixels.end(), 0), 0);
    const Warped back = warp_image(warped.image, face, panorama);
    for (std::size_t i = 0; i < n_shown.size(); ++i) {
      if (back.valid.pixels[i] == 0) continue;
      ++n_shown[i];
      if (i / 256 < 20 || i / 256 >= 108) continue;  // near the poles, a pixel of a face spans many
      EXPECT_NEAR(back.image.pixels[3 * i], image.pixels[3 * i], 3);
      EXPECT_NEAR(back.image.pixels[3 * i + 2], image.pixels[3 * i + 2], 3);
    }
  }
  EXPECT_EQ(std::count(n_shown.begin(), n_shown.end(), 0), 0);
}

TEST(CameraLens, RefusesPanoramasThatAreNotTwiceAsWideAsHigh) {
  EXPECT_TRUE(fails_with<InputError>({"camera 1", "twice as wide as high", "80 x 60"}, [] {
    native(CameraModel::kEquirectangular, {80, 60}, 80, 60);
  }));
}

class LensScene : public SceneFolder {
 protected:
  /// Writes one photograph of 40 x 30 px.
  void write(CameraModel model, std::vector<double> params) {
    ColmapModel colmap;
    ColmapCamera camera;
    camera.id = 1;
    camera.model = model;
    camera.width = kWidth;
    camera.height = kHeight;
    camera.params = std::move(params);
    colmap.cameras[1] = camera;
    ColmapImage image;
    image.id = 1;
    image.camera_id = 1;
    image.name = "a.png";
    colmap.images.push_back(image);
    colmap.points.push_back({1, {0, 0, 3}, {200, 100, 50}, 0.1});
    write_colmap_model(folder_.path() / "sparse" / "0", colmap, ColmapFormat::kText);
    Image8 photograph(kWidth, kHeight, 3);
    for (std::size_t i = 0; i < photograph.pixels.size(); ++i) {
      photograph.pixels[i] = static_cast<std::uint8_t>(i * 7 % 251);
    }
    write_image(folder_.path() / "images" / "a.png", photograph);
    options_.seed_points = false;
  }
};

TEST_F(LensScene, KeepsPhotographsAsTheyAre) {
  write(CameraModel::kOpenCvFisheye, {12, 12, 20, 15, 0.02, -0.004, 0.0005, -0.00002});
  options_.lenses = "native";
  const Scene scene = load();
  const View& view = scene.train.at(0);
  EXPECT_EQ(view.camera.lens.kind, LensKind::kFisheye);
  EXPECT_EQ(view.camera.lens.k[1], -0.004);
  EXPECT_EQ(view.valid, nullptr);
  EXPECT_EQ(view.image->read()->pixels[300], 300 * 7 % 251);
  EXPECT_TRUE(says(scene, "1 image is used as photographed, in the lens (--lenses "));
}

TEST_F(LensScene, UndistortsUnlessAskedOtherwise) {
  write(CameraModel::kOpenCvFisheye, {12, 12, 20, 15, 0.02, -0.004, 0.0005, -0.00002});
  EXPECT_TRUE(load().train.at(0).camera.is_pinhole());
  EXPECT_TRUE(says(load(), "removed from 1 image"));
}

TEST_F(LensScene, AutoKeepsWideLensesOnly) {
  options_.lenses = "auto";
  write(CameraModel::kOpenCvFisheye, {12, 12, 20, 15, 0.02, -0.004, 0.0005, -0.00002});
  EXPECT_FALSE(load().train.at(0).camera.is_pinhole());
  write(CameraModel::kSimpleRadial, {40, 20, 15, -0.02});
  EXPECT_TRUE(load().train.at(0).camera.is_pinhole());
}

TEST_F(LensScene, WarnsWhereTheFormulaFoldsOverInsideTheImage) {
  write(CameraModel::kSimpleRadialFisheye, {10, 20, 15, -0.15});
  options_.lenses = "native";
  const Scene scene = load();
  ASSERT_NE(scene.train.at(0).valid, nullptr);
  ASSERT_EQ(scene.warnings.size(), 1u);
  EXPECT_NE(scene.warnings[0].find("degrees from the axis, less than the image shows"), std::string::npos)
      << scene.warnings[0];
}

TEST_F(LensScene, WarnsWhereUndistortionFoldsOverOrLeavesLittle) {
  const auto warning = [&](CameraModel model, std::vector<double> params) {
    write(model, std::move(params));
    const Scene scene = load();
    EXPECT_LE(scene.warnings.size(), 1u);
    return scene.warnings.empty() ? "" : scene.warnings[0];
  };
  const auto has = [](const std::string& text, const char* part) { return text.find(part) != std::string::npos; };
  const char *folds = "degrees from the axis, inside the image", *is_wrong = "coefficients are probably wrong";
  const std::string mild = warning(CameraModel::kSimpleRadial, {25, 20, 15, -0.5});  // up to a radius of 0.816
  EXPECT_TRUE(has(mild, "sparse/0: camera 1: the lens is used up to 39.2 degrees") && !has(mild, is_wrong)) << mild;
  for (const char* lenses : {"undistort", "auto"}) {
    options_.lenses = lenses;
    const std::string folded = warning(CameraModel::kOpenCv, {40, 40, 20, 15, -3, 0, 0, 0}),
                      lost = warning(CameraModel::kOpenCv, {40, 40, 20, 15, 1e3, 0, 0, 0}),
                      tangential = warning(CameraModel::kOpenCv, {40, 40, 20, 15, 0, 0, 5, 5});
    EXPECT_TRUE(has(folded, "up to 18.4 degrees") && has(folded, is_wrong)) << folded;
    EXPECT_TRUE(has(lost, is_wrong) && !has(lost, folds)) << lost;
    EXPECT_TRUE(has(tangential, is_wrong)) << tangential;
  }
  options_.lenses = "undistort";  // a lens 200 degrees wide, and a strong, but possible one
  EXPECT_EQ(warning(CameraModel::kSimpleFisheye, {14.3, 20, 15}), "");
  EXPECT_EQ(warning(CameraModel::kSimpleRadial, {40, 20, 15, 0.4}), "");
}

}  // namespace
}  // namespace b3dgs::test
