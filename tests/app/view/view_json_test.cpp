#include "app/view/view_json.h"

#include <gtest/gtest.h>

#include <cmath>

#include "support/expect_error.h"

namespace b3dgs {
namespace {

using test::fails_with;

ViewedScene scene_of_two() {
  ViewedScene scene;
  scene.views.resize(2);
  scene.views[0].name = "a.jpg";
  scene.views[0].has_photograph = true;
  scene.views[1].name = "b \xff.jpg";  // not UTF-8
  for (ViewedCamera& view : scene.views) {
    view.camera.width = 400;
    view.camera.height = 200;
    view.camera.fx = view.camera.fy = 300;
    view.camera.cx = 190;
    view.camera.cy = 100;
  }
  scene.views[1].camera.cam_from_world.rotation = rotation_from_quaternion({0.5, 0.1, -0.7, 0.3});
  scene.views[1].camera.cam_from_world.translation = {1, -2, 3};
  return scene;
}

std::string frame_body(const std::string& camera, const std::string& rest = "\"width\":320,\"height\":240") {
  return "{" + rest + ",\"camera\":" + camera + "}";
}

const char* const kCamera = R"({"camera_to_world":[1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,0,1],"fov":90})";

TEST(FrameRequest, ACameraOfItsOwnHasTheSizeAndFieldOfView) {
  const FrameRequest request = parse_frame_request(frame_body(kCamera), {});
  EXPECT_EQ(request.view, -1);
  EXPECT_EQ(request.mode, FrameMode::kRender);
  EXPECT_EQ(request.camera.width, 320);
  EXPECT_EQ(request.camera.height, 240);
  EXPECT_NEAR(request.camera.fy, 120, 1e-9);  // 90 degrees: half the height
  EXPECT_EQ(request.camera.cx, 160);
  // OpenGL's camera looks along -z with +y up, ours along +z with +y down.
  EXPECT_EQ(request.camera.cam_from_world.rotation, (std::array<double, 9>{1, 0, 0, 0, -1, 0, 0, 0, -1}));
}

TEST(FrameRequest, CamerasAreReadAsTheyAreWritten) {
  const ViewedScene scene = scene_of_two();
  const nlohmann::ordered_json view = cameras_json(scene)["views"][1];
  const nlohmann::ordered_json camera{{"camera_to_world", view["camera_to_world"]}, {"fov", view["fov"]}};
  const Camera read = parse_frame_request(frame_body(camera.dump(), "\"width\":400,\"height\":200"), {}).camera;
  const Camera& written = scene.views[1].camera;
  for (std::size_t i = 0; i < 9; ++i) {
    EXPECT_NEAR(read.cam_from_world.rotation[i], written.cam_from_world.rotation[i], 1e-12);
  }
  for (std::size_t i = 0; i < 3; ++i) {
    EXPECT_NEAR(read.cam_from_world.translation[i], written.cam_from_world.translation[i], 1e-12);
  }
  EXPECT_NEAR(read.fy, written.fy, 1e-9);
}

TEST(FrameRequest, AFreeCameraTurnsAPanoramaIntoAPinhole) {
  ViewedScene scene = scene_of_two();
  scene.views[1].camera.lens.kind = LensKind::kEquirectangular;
  EXPECT_NEAR(cameras_json(scene)["views"][1]["fov"].get<double>(), Camera::kDefaultFov, 1e-9);
}

TEST(FrameRequest, AViewKeepsItsCameraScaledIntoTheSize) {
  const FrameRequest request =
      parse_frame_request(R"({"width":200,"height":500,"view":1,"mode":"load","quality":70})", scene_of_two());
  EXPECT_EQ(request.view, 1);
  EXPECT_EQ(request.mode, FrameMode::kLoad);
  EXPECT_EQ(request.quality, 70);
  EXPECT_EQ(request.camera.width, 200);
  EXPECT_EQ(request.camera.height, 100);
  EXPECT_NEAR(request.camera.cx, 95, 1e-9);
  const FrameRequest large = parse_frame_request(R"({"width":1800,"height":1800,"view":0})", scene_of_two());
  EXPECT_EQ(large.camera.width, 1800);
  EXPECT_EQ(large.camera.height, 900);
  EXPECT_NEAR(large.camera.fx, 300 * 4.5, 1e-9);
  const FrameRequest compared =
      parse_frame_request(R"({"width":1800,"height":1800,"view":0,"mode":"difference"})", scene_of_two());
  EXPECT_EQ(compared.camera.width, 400) << "not above the size of the photograph";
}

TEST(FrameRequest, ADraftIsOneThatSaysSo) {
  const auto is_draft = [](const std::string& rest) {
    return parse_frame_request(R"({"width":200,"height":200,"view":0)" + rest + "}", scene_of_two()).is_draft;
  };
  EXPECT_FALSE(is_draft(""));
  EXPECT_FALSE(is_draft(R"(,"draft":false)"));
  EXPECT_TRUE(is_draft(R"(,"draft":true)"));
  EXPECT_TRUE(fails_with<InputError>({"draft: expected true or false"}, [&] { is_draft(R"(,"draft":1)"); }));
}

TEST(FrameRequest, APickIsAPlaceInTheFrame) {
  const auto pick = [](const std::string& rest) {
    return parse_frame_request(R"({"width":200,"height":200,"view":0)" + rest + "}", scene_of_two()).pick;
  };
  EXPECT_FALSE(pick(""));
  EXPECT_EQ(pick(R"(,"pick":[0.25,1])"), (std::array<double, 2>{0.25, 1}));
  for (const char* wrong : {"[0.5]", "[0.5,1.1]", "[-0.1,0]", "[null,0]", "0.5"}) {
    EXPECT_TRUE(fails_with<InputError>({"pick: expected"}, [&] { pick(std::string(",\"pick\":") + wrong); })) << wrong;
  }
}

TEST(FrameRequest, RefusesWhatIsNotARequest) {
  const auto refused = [](const std::string& body, const std::string& part) {
    return fails_with<InputError>({part}, [&] { parse_frame_request(body, scene_of_two()); });
  };
  EXPECT_TRUE(refused("", "not a JSON object"));
  EXPECT_TRUE(refused("[]", "not a JSON object"));
  EXPECT_TRUE(refused("{\"width\":320,", "not a JSON object"));
  EXPECT_TRUE(refused(std::string(4000, '['), "not a JSON object"));
  EXPECT_TRUE(refused("{\"width\":NaN,\"height\":3}", "not a JSON object"));
  EXPECT_TRUE(refused("{}", "missing: \"width\""));
  EXPECT_TRUE(refused(R"({"width":320,"height":240})", "missing: \"camera\""));
  EXPECT_TRUE(refused(R"({"width":"320","height":240,"view":0})", "width"));
  EXPECT_TRUE(refused(R"({"width":320.5,"height":240,"view":0})", "width"));
  EXPECT_TRUE(refused(R"({"width":1e999,"height":240,"view":0})", ""));
  EXPECT_TRUE(refused(R"({"width":-5,"height":240,"view":0})", "width"));
  EXPECT_TRUE(refused(R"({"width":4,"height":240,"view":0})", "size"));
  EXPECT_TRUE(refused(R"({"width":16000,"height":16000,"view":0})", "4000000"));
  EXPECT_TRUE(refused(R"({"width":2001,"height":2000,"view":0})", "4000000"));
  EXPECT_TRUE(refused(R"({"width":320,"height":240,"view":2})", "from 0 to 1"));
  EXPECT_TRUE(refused(R"({"width":320,"height":240,"view":-1})", "view"));
  EXPECT_TRUE(refused(R"({"width":320,"height":240,"view":"../../etc/passwd"})", "view"));
  EXPECT_TRUE(refused(R"({"width":320,"height":240,"view":0,"mode":"x"})", "mode"));
  EXPECT_TRUE(refused(R"({"width":320,"height":240,"view":0,"quality":101})", "quality"));
  EXPECT_TRUE(refused(R"({"width":320,"height":240,"view":1,"mode":"difference"})", "photograph"));
  EXPECT_TRUE(refused(frame_body(kCamera, R"("width":320,"height":240,"mode":"difference")"), "photograph"));
}

TEST(FrameRequest, RefusesCamerasThatAreNone) {
  const auto refused = [](const std::string& camera, const std::string& part) {
    return fails_with<InputError>({part}, [&] { parse_frame_request(frame_body(camera), {}); });
  };
  const auto with = [](const std::string& matrix) { return "{\"camera_to_world\":[" + matrix + "],\"fov\":50}"; };
  EXPECT_TRUE(refused("3", "camera: expected an object"));
  EXPECT_TRUE(refused("{}", "camera_to_world"));
  EXPECT_TRUE(refused(with("1,0,0"), "16 numbers"));
  EXPECT_TRUE(refused(with("1,0,0,null, 0,1,0,0, 0,0,1,0, 0,0,0,1"), "camera_to_world"));
  EXPECT_TRUE(refused(with("1,0,0,1e300, 0,1,0,0, 0,0,1,0, 0,0,0,1"), "camera_to_world"));
  EXPECT_TRUE(refused(with("0,0,0,0, 0,0,0,0, 0,0,0,0, 0,0,0,1"), "rotation"));
  EXPECT_TRUE(refused(with("2,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,0,1"), "rotation"));
  EXPECT_TRUE(refused(with("1,0,0,0, 0,1,0,0, 0,0,-1,0, 0,0,0,1"), "mirrors"));
  EXPECT_TRUE(refused(R"({"camera_to_world":[1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,0,1],"fov":0})", "fov"));
  EXPECT_TRUE(refused(R"({"camera_to_world":[1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,0,1],"fov":180})", "fov"));
  EXPECT_TRUE(refused(R"({"camera_to_world":[1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,0,1]})", "fov"));
}

TEST(ViewJson, NamesThatAreNotUtf8AreSentAllTheSame) {
  const std::string text = json_text(cameras_json(scene_of_two()));
  EXPECT_EQ(nlohmann::json::parse(text)["views"].size(), 2u);
}

TEST(ViewJson, ThePageIsToldWhereItsFrameIs) {
  ViewedScene scene = scene_of_two();
  scene.frame = {{1e6, -2, 0.5}, 0.25};
  const nlohmann::ordered_json json = cameras_json(scene);
  EXPECT_EQ(json["origin"], (std::array<double, 3>{1e6, -2, 0.5}));
  EXPECT_EQ(json["unit"], 0.25);
}

TEST(ViewJson, ThePageIsToldWhichWayIsUpAndThePickedPoint) {
  ViewedScene scene = scene_of_two();
  EXPECT_TRUE(cameras_json(scene)["up"].is_null());
  scene.up = {0, 0, 1};
  scene.is_metric = true;
  EXPECT_EQ(cameras_json(scene)["up"], (std::array<double, 3>{0, 0, 1}));
  EXPECT_EQ(cameras_json(scene)["metric"], true);
  Frame frame;
  EXPECT_TRUE(frame_json(frame)["point"].is_null());
  frame.point = {1.5, -2, 1e7};
  EXPECT_EQ(frame_json(frame)["point"], (std::array<double, 3>{1.5, -2, 1e7}));
}

TEST(ViewJson, Commands) {
  EXPECT_EQ(parse_command(R"({"command":"pause"})"), ViewCommand::kPause);
  EXPECT_EQ(parse_command(R"({"command":"stop"})"), ViewCommand::kStop);
  EXPECT_TRUE(fails_with<InputError>({R"(expected {"command")"}, [] { parse_command("pause"); }));
  for (const char* body : {"", "{}", R"({"command":"delete"})", R"({"command":3})", "pause"}) {
    EXPECT_THROW(parse_command(body), InputError) << body;
  }
}

TEST(ViewJson, WholeNumbersOfQueries) {
  EXPECT_EQ(parse_whole_number("0", "view"), 0);
  EXPECT_EQ(parse_whole_number("123456789", "view"), 123456789);
  for (const char* text : {"", "-1", "1.5", "1e3", "0x10", "12345678901", "../x", " 1"}) {
    EXPECT_TRUE(fails_with<InputError>({"view"}, [&] { parse_whole_number(text, "view"); })) << text;
  }
}

}  // namespace
}  // namespace b3dgs
