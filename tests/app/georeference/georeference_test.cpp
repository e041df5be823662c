// Photographs with GPS positions, and b3dgs georeference as a program.
#include <gtest/gtest.h>

#include <algorithm>
#include <random>

#include "app/georeference/gps.h"
#include "app/georeference/gps_photograph.h"
#include "core/files/folders.h"
#include "scene/colmap/colmap.h"
#include "scene/georeference.h"
#include "support/expect_error.h"
#include "support/files.h"
#include "support/run_program.h"
#include "support/temp_dir.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using Point = std::array<double, 3>;
using test::contains;
using test::GpsTag;
using test::Outcome;
using test::run_b3dgs;
using test::TempDir;
using test::write_gps_photograph;

constexpr GpsTag kOrigin{46.8426, -91.9943, 198.5};

class Gps : public testing::Test {
 protected:
  void SetUp() override {
    if (!can_read_gps()) GTEST_SKIP() << "built without libexiv2 and GeographicLib";
  }
  TempDir folder_;
};

TEST_F(Gps, PositionsHaveHemispheresAndDepthsBelowTheSea) {
  for (const GpsTag& tag : {kOrigin, GpsTag{-33.856784, 151.215297, -4.25}, GpsTag{0.5, -0.25, std::nullopt}}) {
    write_gps_photograph(folder_ / "a.jpg", tag);
    const auto read = read_gps(folder_ / "a.jpg");
    ASSERT_TRUE(read);
    EXPECT_NEAR(read->latitude, tag.latitude, 2e-9);
    EXPECT_NEAR(read->longitude, tag.longitude, 2e-9);
    ASSERT_EQ(read->height.has_value(), tag.height.has_value());
    if (tag.height) {
      EXPECT_NEAR(*read->height, *tag.height, 0.001);
    }
  }
}

TEST_F(Gps, PhotographsWithoutAUsablePosition) {
  write_gps_photograph(folder_ / "none.jpg", std::nullopt);
  write_gps_photograph(folder_ / "no_reception.jpg", GpsTag{0, 0, 0});
  write_gps_photograph(folder_ / "impossible.jpg", GpsTag{97, 8, 0});
  test::write_bytes(folder_ / "damaged.jpg", "\xff\xd8\xff\xe1 not a photograph");
  for (const char* name : {"none.jpg", "no_reception.jpg", "impossible.jpg", "damaged.jpg", "missing.jpg"}) {
    EXPECT_FALSE(read_gps(folder_ / name)) << name;
  }
}

TEST_F(Gps, LocalCoordinatesAndUtmAreThoseOfOtherPrograms) {
  const GpsPosition origin{kOrigin.latitude, kOrigin.longitude, kOrigin.height};
  const UtmPlace utm = utm_place(origin);
  Georeference place;
  place.height = origin.height;
  place.easting = utm.easting;
  place.northing = utm.northing;
  place.convergence = utm.convergence;
  place.grid_scale = utm.grid_scale;
  EXPECT_EQ(utm.epsg, 32615);
  // PROJ 9.1: from these coordinates to EPSG:4979, and from there to EPSG:32615.
  const std::pair<Point, Point> known[]{{{0, 0, 0}, {576682.9240, 5188164.0227, 198.5}},
                                        {{1000, 0, 0}, {577682.4842, 5188176.8228, 198.5783}},
                                        {{0, 1000, 0}, {576670.1230, 5189163.5819, 198.5785}},
                                        {{-700, 700, 100}, {575974.2836, 5188854.7424, 298.5768}},
                                        {{300, -200, -150}, {576985.3589, 5187967.9462, 48.5102}}};
  for (const auto& [local, expected] : known) {
    const Point at = place.to_utm(local);
    for (std::size_t axis = 0; axis < 3; ++axis) EXPECT_NEAR(at[axis], expected[axis], 0.02) << local[0] << " " << axis;
    const GpsTag tag = test::position_of(kOrigin, local);
    const Point back = east_north_up(origin, {tag.latitude, tag.longitude, tag.height});
    for (std::size_t axis = 0; axis < 3; ++axis) EXPECT_NEAR(back[axis], local[axis], 1e-4);
  }
  EXPECT_EQ(utm_place({-33.86, 151.2, 0}).epsg, 32756);
  EXPECT_EQ(utm_place({86, 10, 0}).epsg, 32661);
}

/// A scene of 16 photographs from above, some of which look ahead. Its frame is 5 m per unit, and turned.
class GeoreferenceCommand : public Gps {
 protected:
  GeoreferenceCommand() {
    std::uniform_real_distribution<double> uniform(-1, 1);
    model_.cameras[1] = {1, CameraModel::kPinhole, 8, 6, {10, 10, 4, 3}};
    for (std::uint32_t i = 0; i < 16; ++i) {
      places_.push_back({60 * uniform(random_), 40 * uniform(random_), 30 + 5 * uniform(random_)});
      ColmapImage image;
      image.id = i + 1;
      image.camera_id = 1;
      image.name = std::string(1, static_cast<char>('a' + i)) + ".jpg";
      image.quat = {uniform(random_), uniform(random_), uniform(random_), uniform(random_)};
      const auto turned = rotated(rotation_from_quaternion(image.quat), places_.back());
      image.translation = {-turned[0], -turned[1], -turned[2]};
      image.points_2d = "1.5 2.5 1 3 4 -1";
      model_.images.push_back(image);
    }
    for (std::uint64_t id = 1; id <= 5; ++id) {
      ColmapPoint point;
      point.id = id;
      point.position = {static_cast<double>(id), 2, 3};  // on a plane at 3 m
      point.track = "1 0 2 0";
      model_.points.push_back(point);
    }
    transform({0.2, rotation_from_quaternion({0.9, -0.3, 0.2, 0.6}), {7, 8, 9}}, model_);
    write_colmap_model(scene_ / "sparse/0", model_, ColmapFormat::kText);
  }
  void write_photographs(double error, bool has_heights = true) {
    std::normal_distribution<double> normal(0, 1);
    for (std::size_t i = 0; i < places_.size(); ++i) {
      Point at = places_[i];
      for (double& value : at) value += error * normal(random_);
      if (i == 3) at[0] += 5000;
      if (i == 9) at[2] -= 80;
      GpsTag tag = test::position_of(kOrigin, at);
      if (!has_heights) tag.height.reset();
      write_gps_photograph(scene_ / "images" / model_.images[i].name, tag);
    }
  }
  Outcome run() const { return run_b3dgs({"georeference", scene_.string()}); }

  std::mt19937 random_{3};
  std::vector<Point> places_;  // m from kOrigin
  ColmapModel model_;
  fs::path scene_ = folder_ / "scene";
};

TEST_F(GeoreferenceCommand, PutsTheModelInMetresAndKeepsTheRest) {
  write_photographs(0.2);
  test::write_bytes(scene_ / "sparse/0/test.txt", "a.jpg\n");
  const Outcome outcome = run();
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  EXPECT_TRUE(contains(outcome.out, "of 16 GPS positions agree")) << outcome.out;
  EXPECT_TRUE(contains(outcome.out, "EPSG:32615")) << outcome.out;
  EXPECT_TRUE(contains(outcome.out, "the earlier model is in")) << outcome.out;
  const auto place = read_georeference(scene_);
  ASSERT_TRUE(place);
  EXPECT_EQ(place->n_fixes, 16);
  EXPECT_LE(place->n_kept, 14);
  EXPECT_GE(place->n_kept, 12);
  EXPECT_LT(place->median_residual, 0.6);
  // Cameras are where they were: as positions on the Earth, so wherever the origin is.
  const ColmapModel made = read_colmap_model(scene_ / "sparse/0", Observations::kAll);
  const GpsPosition origin{place->latitude, place->longitude, place->height};
  for (std::size_t i = 0; i < places_.size(); ++i) {
    const GpsTag truth = test::position_of(kOrigin, places_[i]);
    const Point expected = east_north_up(origin, {truth.latitude, truth.longitude, truth.height});
    EXPECT_LT(distance(center_of(made.images[i]), expected), 0.5) << i;
    EXPECT_EQ(made.images[i].points_2d, "1.5 2.5 1 3 4 -1");
  }
  EXPECT_NEAR(*place->height, *kOrigin.height + 3, 0.5) << "the origin is at the height of the points";
  for (const ColmapPoint& point : made.points) {
    EXPECT_NEAR(point.position[2], 0, 0.3);
    EXPECT_EQ(point.track, "1 0 2 0");
  }
  EXPECT_EQ(test::read_bytes(scene_ / "sparse/0/test.txt"), "a.jpg\n");
  const ColmapModel earlier = read_colmap_model(scene_ / "sparse.previous/0");
  EXPECT_EQ(earlier.images[5].translation, model_.images[5].translation);
  // A second call finds hardly anything to change, and leaves no copy of its own model.
  ASSERT_EQ(run().exit_code, 0);
  const ColmapModel again = read_colmap_model(scene_ / "sparse/0");
  EXPECT_LT(distance(center_of(again.images[0]), center_of(made.images[0])), 0.05);
  EXPECT_FALSE(fs::exists(scene_ / "sparse.previous.2"));
}

TEST_F(GeoreferenceCommand, WithoutHeightsTheHeightOfTheOriginIsUnknown) {
  for (ColmapImage& image : model_.images) image.quat = model_.images[0].quat;
  const auto level = [&](ColmapImage& image, const Point& place) {  // looks north, upright
    image.quat = quaternion_from_rotation({1, 0, 0, 0, 0, -1, 0, 1, 0});
    const auto turned = rotated(rotation_from_quaternion(image.quat), place);
    image.translation = {-turned[0], -turned[1], -turned[2]};
  };
  for (std::size_t i = 0; i < places_.size(); ++i) level(model_.images[i], places_[i]);
  transform({0.2, rotation_from_quaternion({0.9, -0.3, 0.2, 0.6}), {7, 8, 9}}, model_);
  write_colmap_model(scene_ / "sparse/0", model_, ColmapFormat::kText);
  write_photographs(0.2, /*has_heights=*/false);
  const Outcome outcome = run();
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  EXPECT_TRUE(contains(outcome.out, "height unknown")) << outcome.out;
  const ColmapModel made = read_colmap_model(scene_ / "sparse/0");
  EXPECT_NEAR(distance(center_of(made.images[0]), center_of(made.images[1])), distance(places_[0], places_[1]), 1);
  EXPECT_NEAR(center_of(made.images[0])[2] - center_of(made.images[1])[2], places_[0][2] - places_[1][2], 0.5);
}

TEST_F(GeoreferenceCommand, BadInputLeavesTheSceneAsItIs) {
  const std::string before = test::read_bytes(scene_ / "sparse/0/images.txt");
  const auto refuses = [&](const std::string& part) {
    const Outcome outcome = run();
    EXPECT_EQ(outcome.exit_code, 2);
    EXPECT_TRUE(contains(outcome.err, part)) << outcome.err;
    EXPECT_EQ(test::read_bytes(scene_ / "sparse/0/images.txt"), before);
    EXPECT_FALSE(fs::exists(scene_ / Georeference::kFile));
    EXPECT_FALSE(fs::exists(scene_ / "sparse.previous"));
  };
  for (const ColmapImage& image : model_.images) write_gps_photograph(scene_ / "images" / image.name, std::nullopt);
  refuses("no photograph of the model has a GPS position in its EXIF data; the scene is unchanged");
  write_gps_photograph(scene_ / "images/a.jpg", kOrigin);
  refuses("only 1 photograph has a camera and a GPS position");
  std::shuffle(places_.begin(), places_.end(), random_);
  write_photographs(0);
  refuses("the GPS positions");
  EXPECT_EQ(run_b3dgs({"georeference"}).exit_code, 2);
  EXPECT_TRUE(contains(run_b3dgs({"georeference", (folder_ / "nowhere").string()}).err, "scene folder not found"));
  test::write_bytes(folder_ / "nerf/transforms.json", "{}");
  EXPECT_TRUE(contains(run_b3dgs({"georeference", (folder_ / "nerf").string()}).err, "found transforms.json"));
}

TEST_F(GeoreferenceCommand, ADamagedFileIsNamed) {
  test::write_bytes(scene_ / Georeference::kFile, R"({"origin": {"latitude": "north"}})");
  EXPECT_TRUE(test::fails_with<InputError>({"georeference.json", "expected the number \"latitude\" in \"origin\""},
                                           [&] { read_georeference(scene_); }));
}

TEST_F(GeoreferenceCommand, CamerasOfTheDroneAreWithinHalfAMetre) {
  const fs::path drone = fs::path(B3DGS_SHARED_DATA) / "drone";
  if (!fs::exists(drone)) GTEST_SKIP() << drone << " is not there";
  remove_tree(scene_);
  fs::copy(drone, scene_, fs::copy_options::recursive);
  const Outcome outcome = run();
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  const auto place = read_georeference(scene_);
  ASSERT_TRUE(place);
  EXPECT_EQ(place->n_fixes, 18);
  EXPECT_GE(place->n_kept, 16);
  EXPECT_LT(place->median_residual, 0.5);
}

}  // namespace
}  // namespace b3dgs
