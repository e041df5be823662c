// All kinds of camera files give the same cameras. Errors in bad files name the frame.
#include "model/cameras/cameras_json.h"

#include <gtest/gtest.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "core/check.h"
#include "core/vec.h"
#include "scene/cameras/camera.h"
#include "scene/cameras/camera_lens.h"
#include "scene/images/image.h"
#include "support/expect_error.h"
#include "support/files.h"
#include "support/temp_dir.h"

namespace b3dgs {
namespace {

using Json = nlohmann::ordered_json;
using test::fails_with;

/// Five cameras of 90 x 60 px with square pixels and different focal lengths.
std::vector<View> some_views() {
  std::vector<View> views;
  for (int i = 0; i < 5; ++i) {
    View view;
    view.name = "images/" + std::to_string(i) + ".png";
    Camera& camera = view.camera;
    camera.width = 90;
    camera.height = 60;
    camera.fx = camera.fy = 70.0 + 3 * i;
    camera.cx = 45;
    camera.cy = 30;
    camera.cam_from_world.rotation = rotation_from_quaternion({0.9, 0.1 * i, -0.3, 0.2 - 0.1 * i});
    camera.cam_from_world.translation = {0.5 * i, -1.0 / 3, 4};
    views.push_back(view);
  }
  return views;
}

Json camera_path(const std::vector<View>& views) {
  Json frames = Json::array();
  for (const View& view : views) {
    frames.push_back({{"camera_to_world", opengl_from_pose(view.camera.cam_from_world)},
                      {"fov", 2 * std::atan(30 / view.camera.fy) * 180 / kPi},
                      {"aspect", 1.5}});
  }
  return {{"camera_type", "perspective"}, {"render_height", 60}, {"render_width", 90},
          {"camera_path", frames},        {"fps", 24},           {"seconds", 5.0 / 24}};
}

Json transforms(const std::vector<View>& views) {
  Json frames = Json::array();
  for (const View& view : views) {
    const OpenGlMatrix m = opengl_from_pose(view.camera.cam_from_world);
    Json rows = Json::array();
    for (std::size_t row = 0; row < 4; ++row)
      rows.push_back({m[4 * row], m[4 * row + 1], m[4 * row + 2], m[4 * row + 3]});
    frames.push_back({{"file_path", view.name}, {"fl_x", view.camera.fx}, {"transform_matrix", rows}});
  }
  return {{"w", 90}, {"h", 60.0}, {"cx", 45}, {"cy", 30}, {"k1", 0.1}, {"frames", frames}};
}

class CameraFiles : public ::testing::Test {
 protected:
  CameraFile read(const Json& json, ImageSize size = {}) const {
    test::write_bytes(file_, json.dump());
    return read_camera_file(file_, size);
  }
  template <class Change>
  testing::AssertionResult refuses(Json json, std::initializer_list<std::string> parts, Change&& change) const {
    change(json);
    return fails_with<InputError>(parts, [&] { read(json); });
  }

  test::TempDir folder_;
  const std::filesystem::path file_ = folder_ / "cameras_of_any_name.json";
  const std::vector<View> views_ = some_views();
};

TEST_F(CameraFiles, OfEveryKindGiveTheSameCameras) {
  const CameraFile expected = read(cameras_to_json({}, views_));
  ASSERT_EQ(expected.cameras.size(), views_.size());
  EXPECT_EQ(expected.fps, 0);
  for (const Json& json : {camera_path(views_), transforms(views_)}) {
    const CameraFile found = read(json);
    ASSERT_EQ(found.cameras.size(), views_.size());
    for (std::size_t i = 0; i < views_.size(); ++i) {
      const Camera &a = expected.cameras[i].camera, &b = found.cameras[i].camera;
      EXPECT_EQ(b.width, 90);
      EXPECT_EQ(b.height, 60);
      for (const auto& [x, y] : {std::pair{a.fx, b.fx}, {a.fy, b.fy}, {a.cx, b.cx}, {a.cy, b.cy}})
        EXPECT_NEAR(x, y, 1e-6);
      for (std::size_t k = 0; k < 9; ++k) {
        EXPECT_NEAR(a.cam_from_world.rotation[k], b.cam_from_world.rotation[k], 1e-6);
      }
      for (std::size_t k = 0; k < 3; ++k) {
        EXPECT_NEAR(a.cam_from_world.translation[k], b.cam_from_world.translation[k], 1e-6);
      }
    }
  }
  EXPECT_EQ(expected.cameras[3].name, "images/3.png");
  EXPECT_EQ(read(transforms(views_)).cameras[3].name, "images/3.png");
}

TEST_F(CameraFiles, TellTheFramesPerSecond) {
  Json json = camera_path(views_);
  EXPECT_EQ(read(json).fps, 24);
  json.erase("fps");
  EXPECT_NEAR(read(json).fps, 24, 1e-9) << "5 frames in 5 / 24 seconds";
  json.erase("seconds");
  EXPECT_EQ(read(json).fps, 0);
}

TEST_F(CameraFiles, AnglesOfViewStandForFocalLengths) {
  Json json = transforms(views_);
  for (Json& frame : json["frames"]) frame.erase("fl_x");
  json["camera_angle_x"] = 2 * std::atan(45 / 80.0);
  json.erase("cx");
  Camera camera = read(json).cameras[1].camera;
  EXPECT_NEAR(camera.fx, 80, 1e-9);
  EXPECT_NEAR(camera.fy, 80, 1e-9) << "square pixels";
  EXPECT_EQ(camera.cx, 45);
  json["camera_angle_y"] = 2 * std::atan(30 / 60.0);
  camera = read(json).cameras[1].camera;
  EXPECT_NEAR(camera.fx, 80, 1e-9);
  EXPECT_NEAR(camera.fy, 60, 1e-9);
}

TEST_F(CameraFiles, WithoutASizeTakeThatOfThePhotographOrTheGivenOne) {
  Json json = transforms(views_);
  json.erase("w");
  json.erase("h");
  for (std::size_t i = 0; i < views_.size(); ++i) {
    json["frames"][i]["file_path"] = "./photo" + std::to_string(i);  // without an extension, as in NeRF-synthetic
  }
  EXPECT_TRUE(fails_with<InputError>({"frame 0 (photo0.png)", "--width and --height"}, [&] { read(json); }));
  EXPECT_EQ(read(json, {30, 20}).cameras[4].camera.width, 30);
  for (std::size_t i = 0; i < views_.size(); ++i) {
    write_image(folder_ / ("photo" + std::to_string(i) + ".png"), Image8(12, 8, 3));
  }
  EXPECT_EQ(read(json).cameras[4].camera.width, 12);
  EXPECT_EQ(read(json, {30, 20}).cameras[4].camera.width, 12) << "fl_x is in px of the photograph";

  Json path = camera_path(views_);
  path.erase("render_width");
  EXPECT_TRUE(fails_with<InputError>({"render_width", "--width and --height"}, [&] { read(path); }));
  EXPECT_NEAR(read(path, {45, 30}).cameras[0].camera.fy, 35, 1e-9) << "the same vertical angle of view";
}

TEST_F(CameraFiles, BadFramesAreNamed) {
  const Json path = camera_path(views_), list = transforms(views_);
  EXPECT_TRUE(refuses(path, {"cameras_of_any_name.json: frame 2", "camera_to_world"},
                      [](Json& json) { json["camera_path"][2].erase("camera_to_world"); }));
  EXPECT_TRUE(refuses(path, {"frame 2", "4 rows of 4 numbers"},
                      [](Json& json) { json["camera_path"][2]["camera_to_world"].erase(3); }));
  EXPECT_TRUE(refuses(path, {"frame 1", "4 rows of 4 numbers"},
                      [](Json& json) { json["camera_path"][1]["camera_to_world"][5] = nullptr; }));
  EXPECT_TRUE(
      refuses(path, {"frame 4", "rotation"}, [](Json& json) { json["camera_path"][4]["camera_to_world"][0] = 17; }));
  EXPECT_TRUE(refuses(path, {"frame 0", "fov", "180"}, [](Json& json) { json["camera_path"][0]["fov"] = 180; }));
  EXPECT_TRUE(refuses(path, {"frame 0", "fov", "wide"}, [](Json& json) { json["camera_path"][0]["fov"] = "wide"; }));
  EXPECT_TRUE(refuses(path, {"frame 3", "found 7"}, [](Json& json) { json["camera_path"][3] = 7; }));
  EXPECT_TRUE(refuses(path, {"at least one frame"}, [](Json& json) { json["camera_path"] = Json::array(); }));
  EXPECT_TRUE(refuses(path, {"at least one frame"}, [](Json& json) { json["camera_path"] = 3; }));
  EXPECT_TRUE(refuses(path, {"render_height", "whole number"}, [](Json& json) { json["render_height"] = 10.5; }));
  EXPECT_TRUE(refuses(path, {"render_width", "1048576"}, [](Json& json) { json["render_width"] = 1e300; }));
  EXPECT_TRUE(refuses(path, {"fps"}, [](Json& json) { json["fps"] = 0; }));
  EXPECT_TRUE(refuses(path, {"camera_type", "fisheye"}, [](Json& json) { json["camera_type"] = "fisheye"; }));
  EXPECT_TRUE(refuses(path, {"keyframes only"}, [](Json& json) {
    json.erase("camera_path");
    json["keyframes"] = Json::array();
  }));
  EXPECT_TRUE(refuses(list, {"frame 1 (images/1.png)", "4 rows of 4 numbers"},
                      [](Json& json) { json["frames"][1]["transform_matrix"][0] = 3; }));
  EXPECT_TRUE(
      refuses(list, {"frame 1 (images/1.png)", "focal length"}, [](Json& json) { json["frames"][1].erase("fl_x"); }));
  EXPECT_TRUE(refuses(list, {"frame 1", "focal length", "-3"}, [](Json& json) { json["frames"][1]["fl_x"] = -3; }));
  EXPECT_TRUE(refuses(list, {"frame 2", "cx"}, [](Json& json) { json["frames"][2]["cx"] = "left"; }));
  EXPECT_TRUE(refuses(list, {"frame 2", "cx"}, [](Json& json) { json["frames"][2]["cx"] = 1e300; }));
  EXPECT_TRUE(refuses(list, {"frame 0 (images/0.png)", "transform_matrix"},
                      [](Json& json) { json["frames"][0].erase("transform_matrix"); }));
  EXPECT_TRUE(
      refuses(list, {"camera_model", "equirectangular"}, [](Json& json) { json["camera_model"] = "equirectangular"; }));
}

TEST_F(CameraFiles, KeepLenses) {
  std::vector<View> views = some_views();
  const Pose pose = views[1].camera.cam_from_world;
  const Camera fisheye{90, 60, 30, 30, 44, 31, pose, {LensKind::kFisheye, {0.02, -0.004, 0.0005, -0.00002}, 0}};
  views[1].camera = native_camera(fisheye, "");
  const Json json = cameras_to_json({}, views);
  EXPECT_FALSE(json[0].contains("camera_model"));
  EXPECT_EQ(json[1]["camera_model"], "THIN_PRISM_FISHEYE");
  EXPECT_EQ(json[1]["fx"], 30) << "for readers that know pinholes only";
  const std::vector<NamedCamera> found = cameras_from_json(json, "cameras.json");
  EXPECT_TRUE(found[0].camera.is_pinhole());
  const LensParams<double>&expected = views[1].camera.lens, &lens = found[1].camera.lens;
  EXPECT_EQ(lens.kind, LensKind::kFisheye);
  EXPECT_TRUE(std::equal(lens.k, lens.k + kLensCoefficients, expected.k));
  EXPECT_EQ(lens.max_angle, expected.max_angle);

  // A reduced panorama need not be twice as wide as high.
  views[1].camera = panorama_camera({156, 78}).scaled_to(156, 77);
  const NamedCamera panorama = cameras_from_json(cameras_to_json({}, views), "cameras.json")[1];
  EXPECT_EQ(panorama.camera.lens.kind, LensKind::kEquirectangular);
  EXPECT_EQ(panorama.camera.height, 77);
  EXPECT_EQ(panorama.camera.fx, views[1].camera.fx);

  const auto refuses = [&](const char* key, const Json& value, const std::string& part) {
    Json bad = json;
    bad[1][key] = value;
    return fails_with<InputError>({"cameras.json: camera 1", part}, [&] { cameras_from_json(bad, "cameras.json"); });
  };
  EXPECT_TRUE(refuses("camera_model", "BALL", "unknown camera model"));
  EXPECT_TRUE(refuses("params", nullptr, "params with camera_model"));
  EXPECT_TRUE(refuses("params", {1, 2, 3}, "found 3 numbers"));
  EXPECT_TRUE(refuses("params", {30, 30, 44, 31, 1e300, 0, 0, 0, 0, 0, 0, 0}, "finite"));
}

TEST_F(CameraFiles, MayHaveCommentsAndUnusedNumbersThatAreNotFinite) {
  for (const Json& json : {camera_path(views_), transforms(views_)}) {
    test::write_bytes(file_, "{/* 5\" */ \"unused\": NaN," + json.dump().substr(1));
    EXPECT_EQ(read_camera_file(file_).cameras.size(), 5u);
  }
  const Json list = cameras_to_json({}, views_);
  test::write_bytes(file_, "// a list\n" + list.dump());
  EXPECT_EQ(read_camera_file(file_).cameras.size(), 5u);
}

TEST_F(CameraFiles, OtherFilesAreRefused) {
  const auto read_bytes = [&](const std::string& bytes) {
    test::write_bytes(file_, bytes);
    read_camera_file(file_);
  };
  const std::string whole = camera_path(views_).dump();
  EXPECT_TRUE(fails_with<InputError>({"not valid JSON"}, [&] { read_bytes(whole.substr(0, whole.size() / 2)); }));
  EXPECT_TRUE(fails_with<InputError>({"not valid JSON"}, [&] { read_bytes(""); }));
  EXPECT_TRUE(fails_with<InputError>({"not valid JSON: parse error at line 1"}, [&] { read_bytes("[NoN]"); }));
  EXPECT_TRUE(fails_with<InputError>({"unknown kind"}, [&] { read_bytes("{}"); }));
  EXPECT_TRUE(fails_with<InputError>({"unknown kind"}, [&] { read_bytes("3"); }));
  EXPECT_TRUE(fails_with<InputError>({"list of cameras"}, [&] { read_bytes("[]"); }));
  EXPECT_TRUE(fails_with<InputError>({"camera 0"}, [&] { read_bytes("[{}]"); }));
  EXPECT_TRUE(fails_with<InputError>({"not found", "none.json"}, [&] { read_camera_file(folder_ / "none.json"); }));
  EXPECT_TRUE(fails_with<InputError>({"cannot be read"}, [&] { read_camera_file(folder_.path()); }));
}

}  // namespace
}  // namespace b3dgs
