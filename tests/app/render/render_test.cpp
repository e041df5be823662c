// b3dgs render with cameras from files and on paths around the scene.
#include <gtest/gtest.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "core/vec.h"
#include "model/cameras/cameras_json.h"
#include "scene/cameras/camera.h"
#include "scene/images/image.h"
#include "support/files.h"
#include "support/run_program.h"
#include "support/temp_dir.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;
using test::Outcome;
using test::read_bytes;
using test::run_b3dgs;
using Words = std::vector<std::string>;

/// A small scene with its Gaussians, truth.ply.
class Render : public ::testing::Test {
 protected:
  Render() {
    const Outcome made = run_b3dgs({"synth", "orbit", path("scene"), "--points", "800", "--views", "8", "--width", "64",
                                    "--height", "48", "--quiet"});
    EXPECT_EQ(made.exit_code, 0) << made.err;
    SceneOptions options;
    options.source_path = path("scene");
    options.load_images = false;
    options.frame = CoordinateFrame{};
    views_ = load_scene(options).train;
    test::write_bytes(folder_ / "cameras.json", cameras_to_json({}, views_).dump());
  }
  std::string path(const std::string& name) const { return (folder_ / name).string(); }
  std::string truth() const { return path("scene/truth.ply"); }

  Outcome render(Words more) const {
    Words words{"render", "--device", "cpu", "--quiet"};
    words.insert(words.end(), more.begin(), more.end());
    return run_b3dgs(words);
  }
  /// Renders truth.ply to the folder `name`.
  void render_to(const std::string& name, Words more) const {
    more.insert(more.begin(), {truth(), "--output", path(name)});
    const Outcome outcome = render(more);
    EXPECT_EQ(outcome.exit_code, 0) << outcome.err;
  }
  int count_images(const std::string& name) const {
    return static_cast<int>(std::distance(fs::directory_iterator(folder_ / name), fs::directory_iterator()));
  }
  void expect_refused(const Words& words, const std::string& part) const {
    const Outcome outcome = render(words);
    EXPECT_EQ(outcome.exit_code, 2) << part;
    EXPECT_NE(outcome.err.find(part), std::string::npos) << outcome.err;
    EXPECT_EQ(std::count(outcome.err.begin(), outcome.err.end(), '\n'), 1) << outcome.err;
  }

  test::TempDir folder_;
  std::vector<View> views_;
};

int largest_difference(const fs::path& a, const fs::path& b) {
  const Image8 first = read_image(a, false), second = read_image(b, false);
  EXPECT_EQ(first.pixels.size(), second.pixels.size());
  int largest = 0;
  for (std::size_t i = 0; i < first.pixels.size(); ++i) {
    largest = std::max(largest, std::abs(int{first.pixels[i]} - int{second.pixels.at(i)}));
  }
  return largest;
}

/// Returns the share of pixels that are more than half covered.
double covered_share(const fs::path& alpha) {
  const Image8 image = read_image(alpha, false);
  const auto n =
      std::count_if(image.pixels.begin(), image.pixels.end(), [](std::uint8_t value) { return value > 127; });
  return static_cast<double>(n) / static_cast<double>(image.pixels.size());
}

TEST_F(Render, CamerasOfAFileGiveTheImagesOfTheirViews) {
  Json path_frames = Json::array(), frames = Json::array();
  for (const View& view : views_) {
    const OpenGlMatrix m = opengl_from_pose(view.camera.cam_from_world);
    const double fov = 2 * std::atan(0.5 * view.camera.height / view.camera.fy) * 180 / kPi;
    path_frames.push_back({{"camera_to_world", m}, {"fov", fov}, {"aspect", 64.0 / 48}});
    frames.push_back({{"file_path", view.name},
                      {"transform_matrix",
                       {{m[0], m[1], m[2], m[3]},
                        {m[4], m[5], m[6], m[7]},
                        {m[8], m[9], m[10], m[11]},
                        {m[12], m[13], m[14], m[15]}}}});
  }
  test::write_bytes(folder_ / "flight.json",
                    Json{{"render_width", 64}, {"render_height", 48}, {"camera_path", path_frames}}.dump());
  test::write_bytes(folder_ / "transforms.json",
                    Json{{"w", 64}, {"h", 48}, {"fl_x", views_[0].camera.fx}, {"frames", frames}}.dump());
  render_to("expected", {"-s", path("scene"), "--path", "train"});
  for (const std::string file : {"cameras.json", "flight.json", "transforms.json"}) {
    render_to("of_" + file, {"--cameras", path(file)});
    EXPECT_EQ(count_images("of_" + file + "/renders"), 8);
    for (const char* image : {"renders/00000.png", "renders/00007.png", "alpha/00003.png"}) {
      EXPECT_LE(largest_difference(folder_ / "expected" / image, folder_ / ("of_" + file) / image), 1) << file;
    }
  }
  const std::string names = read_bytes(folder_ / "expected/views.json");
  EXPECT_EQ(read_bytes(folder_ / "of_transforms.json/views.json"), names);
  EXPECT_EQ(read_bytes(folder_ / "of_cameras.json/views.json"), names);
  EXPECT_FALSE(fs::exists(folder_ / "of_flight.json/views.json")) << "frames of a path have no names";
}

TEST_F(Render, NoImageOfAnEarlierCallStays) {
  render_to("out", {"--path", "turntable", "--frames", "3"});
  test::write_bytes(folder_ / "out/renders/mine.png", "mine");
  render_to("out", {"--path", "turntable", "--frames", "2", "--no_depth", "--no_alpha"});
  EXPECT_EQ(count_images("out/renders"), 3);  // two, and one of the user
  EXPECT_EQ(test::read_bytes(folder_ / "out/renders/mine.png"), "mine");
  EXPECT_FALSE(fs::exists(folder_ / "out/depth"));
}

TEST_F(Render, TheImageSizeCanBeChosen) {
  const Words cameras{"--cameras", path("cameras.json"), "--no_depth", "--no_alpha"};
  const auto size_of = [&](const std::string& name, const Words& size) {
    Words words = cameras;
    words.insert(words.end(), size.begin(), size.end());
    render_to(name, words);
    return read_image_size(folder_ / name / "renders/00000.png");
  };
  EXPECT_EQ(size_of("w", {"--width", "32"}), (ImageSize{32, 24}));
  EXPECT_EQ(size_of("h", {"--height", "24"}), (ImageSize{32, 24}));
  EXPECT_EQ(size_of("both", {"--width", "96", "--height", "48"}), (ImageSize{96, 48}));
  render_to("own", cameras);
  const Image8 own = read_image(folder_ / "own/renders/00000.png", false);
  const Image8 wide = read_image(folder_ / "both/renders/00000.png", false);
  for (int row = 0; row < 48; ++row) {  // the middle of the wider image equals the narrower one
    for (int i = 0; i < 3 * 64; ++i) {
      ASSERT_NEAR(wide.pixels[static_cast<std::size_t>(3 * (row * 96 + 16) + i)],
                  own.pixels[static_cast<std::size_t>(3 * row * 64 + i)], 1);
    }
  }
}

TEST_F(Render, PathsOfAFileOfGaussians) {
  render_to("around", {"--path", "turntable", "--frames", "5", "--width", "60", "--up", "z"});
  EXPECT_EQ(count_images("around/renders"), 5);
  EXPECT_EQ(read_image_size(folder_ / "around/renders/00004.png"), (ImageSize{60, 34})) << "1280 x 720 without cameras";
  for (const char* name : {"00000.png", "00002.png", "00004.png"}) {
    EXPECT_GT(covered_share(folder_ / "around/alpha" / name), 0.1) << "the scene is in the picture";
    EXPECT_LT(covered_share(folder_ / "around/alpha" / name), 0.95) << "the camera is outside";
  }
  render_to("through", {"--cameras", path("cameras.json"), "--path", "interpolated", "--frames", "15"});
  EXPECT_EQ(count_images("through/renders"), 15);
  render_to("views", {"--cameras", path("cameras.json")});
  EXPECT_LE(largest_difference(folder_ / "through/renders/00004.png", folder_ / "views/renders/00002.png"), 1);

  const Outcome orbit = render({truth(), "-s", path("scene"), "--path", "orbit", "--frames", "3"});
  EXPECT_EQ(orbit.exit_code, 0) << orbit.err;
  EXPECT_NE(orbit.out.find("up (0, 0, 1)"), std::string::npos) << orbit.out;
  EXPECT_EQ(count_images("scene/truth_orbit/renders"), 3);
  EXPECT_GT(covered_share(folder_ / "scene/truth_orbit/alpha/00001.png"), 0.3);
}

TEST_F(Render, AModelIsRenderedWithCamerasOfAFile) {
  const Outcome trained =
      run_b3dgs({"train", path("scene"), "-m", path("model"), "--iterations", "2", "--device", "cpu", "--quiet"});
  ASSERT_EQ(trained.exit_code, 0) << trained.err;
  remove_tree(path("scene"));
  const Outcome rendered = render({path("model"), "--cameras", path("cameras.json")});
  EXPECT_EQ(rendered.exit_code, 0) << rendered.err;
  EXPECT_EQ(count_images("model/cameras/cameras/ours_2/renders"), 8);
  const Outcome around = render({path("model"), "--path", "turntable", "--elevation", "30", "--frames", "4"});
  EXPECT_EQ(around.exit_code, 0) << around.err;
  EXPECT_EQ(count_images("model/turntable/ours_2/renders"), 4);
}

// If no scene is read, the unit of --near_plane is still that of the training.
TEST_F(Render, ViewsOfAModelAreThoseThatEvalMeasures) {
  for (const Words& words : {Words{"train", path("scene"), "-m", path("model"), "--iterations", "30", "--eval",
                                   "--near_plane", "4", "--device", "cpu", "--quiet"},
                             Words{"eval", path("model"), "--save_images", "--device", "cpu", "--quiet"}}) {
    const Outcome outcome = run_b3dgs(words);
    ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  }
  EXPECT_EQ(render({path("model"), "--output", path("rendered")}).exit_code, 0);
  EXPECT_EQ(read_bytes(folder_ / "rendered/renders/00000.png"),
            read_bytes(folder_ / "model/test/ours_30/renders/00000.png"));
}

TEST_F(Render, AFileIsRenderedFromTheTestViewsOfAScene) {
  render_to("tested", {"-s", path("scene"), "--path", "test"});
  EXPECT_EQ(count_images("tested/renders"), 1) << "every 8th view by name";
}

TEST_F(Render, AnImageThatCannotBeWrittenEndsItWithOneLine) {
  for (const std::string part : {"renders", "depth"}) {
    const std::string name = "no_" + part;
    fs::create_directories(folder_ / name);
    fs::create_symlink(part, folder_ / name / part);  // a link to itself with the name of a required folder
    expect_refused({truth(), "--output", path(name), "--path", "turntable", "--frames", "40", "--up", "z", "--width",
                    "64", "--height", "48"},
                   "cannot create folder: " + path(name) + "/" + part);
    for (const fs::directory_entry& entry : fs::recursive_directory_iterator(folder_ / name)) {
      if (entry.path().parent_path() == folder_ / name || entry.is_directory()) continue;
      EXPECT_EQ(entry.path().filename().string().size(), std::string("00000.png").size()) << "a temporary file";
      EXPECT_EQ(read_image(entry.path(), false).width, 64) << entry.path();
    }
  }
}

TEST_F(Render, TheProjectionCanBeChosen) {
  const Words cameras{"--cameras", path("cameras.json"), "--no_depth", "--no_alpha"};
  const auto render_as = [&](const std::string& name, const Words& more) {
    Words words = cameras;
    words.insert(words.end(), more.begin(), more.end());
    render_to(name, words);
    return read_image(folder_ / name / "renders/00000.png", false);
  };
  const Image8 own = render_as("own", {}), pinhole = render_as("pinhole", {"--projection", "pinhole"});
  EXPECT_EQ(own.pixels, pinhole.pixels);
  const Image8 panorama = render_as("panorama", {"--projection", "equirectangular", "--height", "160"});
  EXPECT_EQ(panorama.width, 320);
  EXPECT_EQ(panorama.height, 160);
  const Image8 fisheye = render_as("fisheye", {"--projection", "fisheye", "--fov", "200"});
  // The same direction, the axis, is in the centre of each image.
  const auto middle = [](const Image8& image) {
    return image.pixels[static_cast<std::size_t>(3 * (image.height / 2 * image.width + image.width / 2) + 1)];
  };
  EXPECT_NEAR(middle(panorama), middle(own), 40);
  EXPECT_NEAR(middle(fisheye), middle(own), 40);
  expect_refused({truth(), "--cameras", path("cameras.json"), "--projection", "equirectangular", "--width", "64",
                  "--height", "64"},
                 "twice as wide as high");
  expect_refused({truth(), "--path", "turntable", "--fov", "200"}, "--projection fisheye");
}

TEST_F(Render, OptionsThatContradictEachOtherAreErrors) {
  const std::string cameras = path("cameras.json");
  expect_refused({truth()}, "--cameras or --path turntable");
  expect_refused({truth(), "--path", "train"}, "name a scene with -s");
  expect_refused({truth(), "--cameras", cameras, "--path", "train"}, "--cameras replaces --path train");
  expect_refused({truth(), "--cameras", cameras, "-r", "2"}, "use --width and --height");
  expect_refused({truth(), "--cameras", cameras, "--frames", "3"}, "--frames is for");
  expect_refused({truth(), "--cameras", cameras, "--fov", "30"}, "--fov is for");
  expect_refused({truth(), "--path", "orbit", "--elevation", "30"}, "--elevation is for");
  expect_refused({truth(), "--path", "turntable", "--fps", "30"}, "--fps is for --video");
  expect_refused({truth(), "--path", "turntable", "--elevation", "90"}, "--elevation");
  expect_refused({truth(), "--cameras", path("none.json")}, "camera file not found");
  expect_refused({truth(), "--cameras", truth()}, "not valid JSON");
}

}  // namespace
}  // namespace b3dgs
