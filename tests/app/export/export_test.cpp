// b3dgs export: written files, removed Gaussians, measurements and errors. A stub replaces splat-transform. The real
// program is tested if it is installed (scripts/check_exports.sh).
#include <gtest/gtest.h>

#include <algorithm>
#include <cctype>
#include <cmath>
#include <csignal>
#include <cstdlib>
#include <nlohmann/json.hpp>
#include <sstream>

#include "app/export/scene_views.h"
#include "core/check.h"
#include "core/files/folders.h"
#include "core/process/child_process.h"
#include "core/text.h"
#include "model/cameras/cameras_json.h"
#include "model/edit/edit.h"
#include "model/formats/splat_formats.h"
#include "support/expect_error.h"
#include "support/files.h"
#include "support/run_program.h"
#include "support/same.h"
#include "support/temp_dir.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using test::fails_with;
using test::Outcome;
using test::run_b3dgs;

/// Sets PATH for the programs that a test starts.
class ScopedPath {
 public:
  explicit ScopedPath(const std::string& path) : before_(std::getenv("PATH")) { setenv("PATH", path.c_str(), 1); }
  ~ScopedPath() { setenv("PATH", before_.c_str(), 1); }
  ScopedPath(const ScopedPath&) = delete;
  ScopedPath& operator=(const ScopedPath&) = delete;
  const std::string& before() const { return before_; }

 private:
  std::string before_;
};

class Export : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder_ = new test::TempDir;
    const Outcome made = run_b3dgs({"synth", "orbit", path("scene"), "--points", "300", "--views", "9", "--width", "64",
                                    "--height", "48", "--seed", "1", "--quiet"});
    EXPECT_EQ(made.exit_code, 0) << made.err;
    const Outcome trained =
        run_b3dgs({"train", path("scene"), "-m", path("model"), "--eval", "--iterations", "20",
                   "--sh_increase_interval", "5", "--kernel", "naive", "--device", "cpu", "--quiet"});
    EXPECT_EQ(trained.exit_code, 0) << trained.err;
  }
  static void TearDownTestSuite() {
    delete folder_;
    folder_ = nullptr;
  }

  static std::string path(const std::string& name) { return (*folder_ / name).string(); }
  static std::string ply() { return path("model/point_cloud/iteration_20/point_cloud.ply"); }
  static Outcome run_export(std::vector<std::string> words) {
    words.insert(words.begin(), "export");
    words.insert(words.end(), {"--device", "cpu", "--quiet"});
    return run_b3dgs(words);
  }

  static Camera first_camera() {
    std::vector<NamedCamera> cameras = read_cameras_json(path("model/cameras.json"));
    cameras.erase(std::remove_if(cameras.begin(), cameras.end(), [](const NamedCamera& c) { return c.held_out; }),
                  cameras.end());
    return std::min_element(cameras.begin(), cameras.end(),
                            [](const NamedCamera& a, const NamedCamera& b) { return a.name < b.name; })
        ->camera;
  }

  static test::TempDir* folder_;
};
test::TempDir* Export::folder_ = nullptr;

TEST_F(Export, WritesSpzThatTheOtherCommandsTake) {
  const Outcome outcome = run_export({path("model"), path("a.spz")});
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  const std::int64_t n = read_splat_ply(ply()).size();
  for (const std::string& part : {format_count(n) + " Gaussians, SH degree 3",
                                  std::string("dB lost (mean of 2 test views)"), std::string("against those before")}) {
    EXPECT_TRUE(test::contains(outcome.out, part)) << part << " is not in: " << outcome.out;
  }
  EXPECT_EQ(read_spz(path("a.spz")).size(), n);
  EXPECT_LT(fs::file_size(path("a.spz")), fs::file_size(ply()) / 3);

  const Outcome info = run_b3dgs({"info", path("a.spz")});
  EXPECT_TRUE(test::contains(info.out, "Gaussians         " + format_count(n))) << info.out << info.err;
  const Outcome eval = run_b3dgs({"eval", path("a.spz"), "-s", path("scene"), "--split", "test", "--quiet"});
  EXPECT_TRUE(test::contains(eval.out, "mean of 2")) << eval.out << eval.err;
  const Outcome all = run_b3dgs({"eval", path("a.spz"), "-s", path("scene"), "--quiet"});
  EXPECT_TRUE(test::contains(all.out, "mean of 9")) << all.out << all.err;
  write_splat_ply(path("decoded.ply"), read_spz(path("a.spz")));
  for (const std::string file : {"a.spz", "decoded.ply"}) {
    const Outcome rendered =
        run_b3dgs({"render", path(file), "-s", path("scene"), "--output", path(file + "_images"), "--quiet"});
    ASSERT_EQ(rendered.exit_code, 0) << rendered.err;
  }
  const std::string image = test::read_bytes(path("a.spz_images/renders/00001.png"));
  EXPECT_FALSE(image.empty());
  EXPECT_TRUE(test::same(image, test::read_bytes(path("decoded.ply_images/renders/00001.png"))));
  const Outcome trained = run_b3dgs({"train", path("scene"), "-m", path("second"), "--init_ply", path("a.spz"),
                                     "--iterations", "2", "--device", "cpu", "--quiet"});
  EXPECT_EQ(trained.exit_code, 0) << trained.err;
}

TEST_F(Export, ACopyAsPlyLosesNothing) {
  const Outcome outcome = run_export({path("model"), path("copy.ply")});
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  EXPECT_TRUE(test::contains(outcome.out, "0.00 dB lost")) << outcome.out;
  EXPECT_TRUE(test::contains(outcome.out, "100.00 dB, those after")) << outcome.out;
  EXPECT_TRUE(test::same(test::read_bytes(path("copy.ply")), test::read_bytes(ply())));
}

TEST_F(Export, SaysWhatWasGained) {
  SplatCloud cloud = read_splat_ply(ply());
  for (std::size_t i = 0; i < cloud.shN.size(); ++i) cloud.shN[i] = i % 2 == 0 ? 1.0f : -1.0f;
  write_splat_ply(path("gaudy.ply"), cloud);
  const Outcome outcome =
      run_export({path("gaudy.ply"), path("plain.ply"), "-s", path("scene"), "--max_sh_degree", "0"});
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  EXPECT_TRUE(test::contains(outcome.out, " dB gained (mean of ")) << outcome.out;
  EXPECT_FALSE(test::contains(outcome.out, "lost")) << outcome.out;
}

TEST_F(Export, ReplacesNothingUnlessAsked) {
  test::write_bytes(path("kept.spz"), "important");
  const Outcome refused = run_export({path("model"), path("kept.spz")});
  EXPECT_EQ(refused.exit_code, 2);
  EXPECT_TRUE(test::contains(refused.err, "--overwrite")) << refused.err;
  EXPECT_EQ(test::read_bytes(path("kept.spz")), "important");
  EXPECT_EQ(run_export({path("model"), path("kept.spz"), "--overwrite"}).exit_code, 0);
  EXPECT_EQ(read_spz(path("kept.spz")).size(), read_splat_ply(ply()).size());
  const Outcome itself = run_export({path("kept.spz"), path("kept.spz"), "--overwrite"});
  EXPECT_EQ(itself.exit_code, 2);
  EXPECT_TRUE(test::contains(itself.err, "is a file to read")) << itself.err;
  const std::string before = test::read_bytes(ply());
  const Outcome model_ply = run_export({path("model"), ply(), "--overwrite", "--max_gaussians", "9"});
  EXPECT_TRUE(test::contains(model_ply.err, "is a file to read")) << model_ply.err;
  EXPECT_TRUE(test::same(test::read_bytes(ply()), before));
}

TEST_F(Export, LeavesOutWhatTheOptionsSay) {
  const SplatCloud before = read_splat_ply(ply());
  const Outcome outcome = run_export(
      {path("model"), path("small.ply"), "--crop=-1,-1,-1,1,1,1", "--max_sh_degree", "1", "--max_gaussians", "20"});
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  EXPECT_TRUE(test::contains(outcome.out, "least contribution to 7 training views")) << outcome.out;
  EXPECT_FALSE(test::contains(outcome.out, "dB lost"))
      << "--crop leaves out what the photographs show: " << outcome.out;
  EXPECT_TRUE(test::contains(outcome.out, "both cropped")) << outcome.out;
  const SplatCloud after = read_splat_ply(path("small.ply"));
  EXPECT_EQ(after.size(), 20);
  EXPECT_EQ(after.sh_degree, 1);
  for (const float value : after.means) EXPECT_LE(std::abs(value), 1);
  const Outcome none = run_export({path("model"), path("none.ply"), "--crop", "1000,1000,1000,1"});
  EXPECT_EQ(none.exit_code, 2);
  EXPECT_TRUE(test::contains(none.err, "no Gaussian is left")) << none.err;
  EXPECT_FALSE(fs::exists(path("none.ply")));
  const Outcome opaque = run_export({path("model"), path("opaque.ply"), "--min_opacity", "0.1"});
  ASSERT_EQ(opaque.exit_code, 0) << opaque.err;
  const SplatCloud rest = read_splat_ply(path("opaque.ply"));
  for (const float logit : rest.logit_opacities) EXPECT_GE(1 / (1 + std::exp(-logit)), 0.0999f);
}

TEST_F(Export, KeepsTheGaussiansThatMatterToTheViews) {
  // Some Gaussians are made transparent, and as many are moved out of view of all cameras.
  constexpr std::size_t kEach = 30;
  SplatCloud cloud = read_splat_ply(ply());
  ASSERT_GT(cloud.size(), 3 * std::int64_t{kEach});
  for (std::size_t i = 0; i < kEach; ++i) {
    cloud.logit_opacities[i] = -8;
    cloud.means[3 * (kEach + i)] = 1e5f;
    cloud.log_scales[3 * (kEach + i)] = 3;  // opacity times area would keep it
  }
  write_splat_ply(path("padded.ply"), cloud);
  const std::string kept = std::to_string(cloud.size() - 2 * std::int64_t{kEach});
  const Outcome outcome =
      run_export({path("padded.ply"), path("useful.ply"), "-s", path("scene"), "--max_gaussians", kept});
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  const std::vector<float> useful(cloud.logit_opacities.begin() + 2 * kEach, cloud.logit_opacities.end());
  EXPECT_EQ(read_splat_ply(path("useful.ply")).logit_opacities, useful);
  const Outcome blind = run_export({path("padded.ply"), path("blind.ply"), "--max_gaussians", kept});
  ASSERT_EQ(blind.exit_code, 0) << blind.err;
  EXPECT_NE(read_splat_ply(path("blind.ply")).logit_opacities, useful);
  EXPECT_TRUE(test::contains(blind.out, "opacity times area, for lack of a scene")) << blind.out;
  EXPECT_TRUE(test::contains(blind.out, "not measured: no scene is named (-s SCENE)")) << blind.out;
}

TEST_F(Export, TurnsTheModelUpright) {
  const Outcome outcome = run_export({path("model"), path("up.ply"), "--up", "-y"});
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  EXPECT_TRUE(test::contains(outcome.out, "0.00 dB lost")) << "measured before rotating: " << outcome.out;
  // Cameras of this scene are on a ring about the z axis, which points up.
  SplatCloud expected = read_splat_ply(ply());
  rotate_splats(rotation_between({0, 0, 1}, {0, -1, 0}), expected);
  const SplatCloud after = read_splat_ply(path("up.ply"));
  ASSERT_EQ(after.size(), expected.size());
  for (std::size_t i = 0; i < expected.means.size(); ++i) EXPECT_NEAR(after.means[i], expected.means[i], 1e-3) << i;
  const Outcome blind = run_export({path("up.ply"), path("up2.ply"), "--up", "auto"});
  EXPECT_EQ(blind.exit_code, 2);
  EXPECT_TRUE(test::contains(blind.err, "needs cameras")) << blind.err;
}

TEST_F(Export, MakesTheDistanceOfTwoPointsTrue) {
  const Outcome outcome = run_export({path("model"), path("scaled.ply"), "--scale", "0,0,0,0,3,4,10"});
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  EXPECT_TRUE(test::contains(outcome.out, "0.00 dB lost")) << "measured before scaling: " << outcome.out;
  const SplatCloud before = read_splat_ply(ply()), after = read_splat_ply(path("scaled.ply"));
  for (std::size_t i = 0; i < before.means.size(); ++i) {
    EXPECT_NEAR(after.means[i], 2 * before.means[i], 1e-4);
    EXPECT_NEAR(after.log_scales[i], before.log_scales[i] + std::log(2), 1e-4);
  }
}

TEST_F(Export, WritesUtmOfAGeoreferencedModel) {
  const Outcome blind = run_export({path("model"), path("utm.ply"), "--to_utm"});
  EXPECT_EQ(blind.exit_code, 2);
  EXPECT_TRUE(test::contains(blind.err, "has no georeference.json")) << blind.err;
  Georeference place;
  place.epsg = 32615;
  place.easting = 576682.924;
  place.northing = 5188164.023;
  place.height = 198.5;
  place.convergence = 0.73;
  place.grid_scale = 0.99964;
  write_georeference(path("model"), place);
  ASSERT_EQ(run_export({path("model"), path("utm.ply"), "--to_utm"}).exit_code, 0);
  const Outcome points = run_export({path("model"), path("utm.las"), "--to_utm"});
  ASSERT_EQ(points.exit_code, 0) << points.err;
  EXPECT_TRUE(test::contains(points.out, "EPSG:32615")) << points.out;
  EXPECT_TRUE(test::contains(points.out, "not measured: the file has points")) << points.out;
  const auto refuses = [&](const std::vector<std::string>& words, const std::string& part) {
    const Outcome outcome = run_export(words);
    EXPECT_EQ(outcome.exit_code, 2) << outcome.err;
    EXPECT_TRUE(test::contains(outcome.err, part)) << outcome.err;
  };
  refuses({path("model"), path("utm.spz"), "--to_utm"}, "--to_utm is for .ply and .las");
  refuses({path("model"), path("utm2.ply"), "--to_utm", "--up", "-y"}, "leave out --up and --scale");
  fs::remove(path("model/georeference.json"));
  const SplatCloud before = read_splat_ply(ply()), after = read_splat_ply(path("utm.ply"));
  EXPECT_TRUE(after.frame.is_far());
  ASSERT_EQ(after.size(), before.size());
  const std::string las = test::read_bytes(path("utm.las"));
  EXPECT_EQ(las.size(), 227 + 54 + 40 + 26 * static_cast<std::size_t>(before.size()));
  for (std::size_t i = 0; i < before.means.size(); i += 3) {
    const auto at = after.frame.to_world(&after.means[i]),
               expected = place.to_utm(before.frame.to_world(&before.means[i]));
    for (std::size_t axis = 0; axis < 3; ++axis) EXPECT_NEAR(at[axis], expected[axis], 1e-4);
  }
}

TEST_F(Export, WritesVersion4OfSpz) {
  const Outcome outcome = run_export({path("model"), path("v4.spz"), "--spz_version", "4"});
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  EXPECT_EQ(test::read_bytes(path("v4.spz")).substr(0, 5), "NGSP\4");
  EXPECT_EQ(read_spz(path("v4.spz")).size(), read_splat_ply(ply()).size());
  ASSERT_EQ(run_export({path("v4.spz"), path("v3.spz")}).exit_code, 0);
  EXPECT_EQ(read_spz(path("v3.spz")).size(), read_spz(path("v4.spz")).size());
  test::write_bytes(path("cut.spz"), test::read_bytes(path("v4.spz")).substr(0, 500));
  const Outcome cut = run_export({path("cut.spz"), path("b.ply")});
  EXPECT_EQ(cut.exit_code, 2);
  EXPECT_TRUE(test::contains(cut.err, "cut.spz: the file ends early; it is truncated")) << cut.err;
  const Outcome other = run_export({path("model"), path("b.ply"), "--spz_version", "4"});
  EXPECT_EQ(other.exit_code, 2);
  EXPECT_TRUE(test::contains(other.err, "--spz_version is for .spz")) << other.err;
}

TEST_F(Export, RemovesTheFloatersThatTheSummaryCounts) {
  // Some Gaussians are moved behind all cameras, and one is put in front of one.
  constexpr std::size_t kUnseen = 12;
  SplatCloud cloud = read_splat_ply(ply());
  const Outcome before = run_export({path("model"), path("clean.ply"), "--remove_floaters", "--floater_kinds", "all"});
  ASSERT_EQ(before.exit_code, 0) << before.err;
  const std::string info = run_b3dgs({"info", path("model")}).out;  // "possible: 1 in no training view, 2 in ..."
  const std::size_t at = info.find("possible: ");
  ASSERT_NE(at, std::string::npos) << info;
  std::string counts;  // each number of that line
  for (std::size_t i = at; info[i] != ';'; ++i) counts += std::isdigit(info[i]) != 0 ? info[i] : ' ';
  std::istringstream numbers(counts);
  std::string expected;
  for (const char* kind : {" unseen, ", " one_view, ", " close, ", " large)"}) {
    std::int64_t n = 0;
    numbers >> n;
    expected += std::to_string(n) + kind;
  }
  EXPECT_TRUE(test::contains(before.out, "Gaussians that may be floaters (" + expected)) << info << before.out;
  EXPECT_TRUE(test::contains(before.out, "SSIM        0.")) << before.out;
  for (std::size_t i = 0; i < kUnseen; ++i) cloud.means[3 * i + 2] = 1e4f;
  write_splat_ply(path("floating.ply"), cloud);
  const Outcome outcome = run_export({path("floating.ply"), path("unseen.ply"), "-s", path("scene"),
                                      "--remove_floaters", "--floater_kinds", "unseen"});
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  const SplatCloud rest = read_splat_ply(path("unseen.ply"));
  EXPECT_LE(rest.size(), cloud.size() - std::int64_t{kUnseen});
  for (std::size_t i = 2; i < rest.means.size(); i += 3) EXPECT_LT(rest.means[i], 1e3f);
  EXPECT_TRUE(test::contains(outcome.out, "0.00 dB lost")) << outcome.out;
  const Outcome blind = run_export({path("floating.ply"), path("b.ply"), "--remove_floaters"});
  EXPECT_EQ(blind.exit_code, 2);
  EXPECT_TRUE(test::contains(blind.err, "needs the training views")) << blind.err;
  const Outcome unknown = run_export({path("model"), path("b.ply"), "--floater_kinds", "unseen,big"});
  EXPECT_EQ(unknown.exit_code, 2);
  EXPECT_TRUE(test::contains(unknown.err, "found \"big\"")) << unknown.err;
}

TEST_F(Export, CropsByAFile) {
  test::write_bytes(path("crop.txt"), "# a region\n-1,-1,-1,1,1,1\n");
  ASSERT_EQ(run_export({path("model"), path("by_file.ply"), "--crop", path("crop.txt")}).exit_code, 0);
  ASSERT_EQ(run_export({path("model"), path("by_text.ply"), "--crop=-1,-1,-1,1,1,1"}).exit_code, 0);
  EXPECT_TRUE(test::same(test::read_bytes(path("by_file.ply")), test::read_bytes(path("by_text.ply"))));
  test::write_bytes(path("crop.txt"), "{\"box\": [1, 2]}\n");
  const Outcome bad = run_export({path("model"), path("b.ply"), "--crop", path("crop.txt")});
  EXPECT_EQ(bad.exit_code, 2);
  EXPECT_TRUE(test::contains(bad.err, "crop.txt:1: expected a coordinate")) << bad.err;
}

TEST_F(Export, PagesOpenUprightAtTheFirstCamera) {
  const fs::path folder = *folder_ / "bin3";
  fs::create_directory(folder);
  test::write_bytes(folder / "splat-transform",
                    "#!/bin/sh\nwhile [ $# -gt 2 ]; do [ \"$1\" = -E ] && settings=$2; shift; done\n"
                    "echo '<title>SuperSplat Viewer</title>' >\"$2\"\ncat \"$settings\" >>\"$2\"\ncp \"$1\" '" +
                        path("page.ply") + "'\n");
  fs::permissions(folder / "splat-transform", fs::perms::owner_all);
  const ScopedPath first(folder.string() + ":/usr/bin:/bin");
  ASSERT_EQ(run_export({path("model"), path("page.html"), "--compare_views", "0"}).exit_code, 0);
  SplatCloud expected = read_splat_ply(ply());
  rotate_splats(rotation_between({0, 0, 1}, {0, -1, 0}), expected);  // z is up in this scene
  const SplatCloud written = read_splat_ply(path("page.ply"));
  ASSERT_EQ(written.size(), expected.size());
  for (std::size_t i = 0; i < expected.means.size(); ++i) EXPECT_NEAR(written.means[i], expected.means[i], 1e-3) << i;
  const std::string page = test::read_bytes(path("page.html"));
  const std::size_t end = page.find('\n');
  EXPECT_EQ(page.substr(0, end), "<title>model</title>");
  const nlohmann::json settings = nlohmann::json::parse(page.substr(end + 1));
  const auto position = settings["camera"]["position"].get<std::vector<double>>();
  const auto target = settings["camera"]["target"].get<std::vector<double>>();
  const std::array<double, 3> camera = first_camera().center();  // y is up in the viewer, and x and z are turned
  EXPECT_NEAR(position[0], -camera[0], 1e-4);
  EXPECT_NEAR(position[1], camera[2], 1e-4);
  EXPECT_NEAR(position[2], camera[1], 1e-4);
  for (const double value : target) EXPECT_NEAR(value, 0, 0.5);  // the cameras look at the origin
  EXPECT_EQ(settings["background"]["color"], nlohmann::json::array({0, 0, 0}));

  fs::copy(ply(), path("a<b&c.ply"));
  ASSERT_EQ(run_export({path("a<b&c.ply"), path("file.html"), "--compare_views", "0"}).exit_code, 0);
  EXPECT_EQ(test::read_bytes(path("file.html")).substr(0, 29), "<title>a&lt;b&amp;c</title>\n{");
}

TEST_F(Export, DoesWithoutPhotographs) {
  fs::rename(path("scene"), path("moved"));
  const Outcome outcome = run_export({path("model"), path("blind.spz"), "--up", "auto", "--max_gaussians", "50"});
  fs::rename(path("moved"), path("scene"));
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  EXPECT_TRUE(test::contains(outcome.out, "contribution to 7 training views")) << outcome.out;
  EXPECT_TRUE(test::contains(outcome.out, "not measured: ")) << outcome.out;
  EXPECT_EQ(read_spz(path("blind.spz")).size(), 50);
}

TEST_F(Export, RefusesWhatCannotBeDone) {
  const auto refuses = [&](const std::vector<std::string>& words, const std::string& part) {
    const Outcome outcome = run_export(words);
    EXPECT_EQ(outcome.exit_code, 2) << outcome.err;
    EXPECT_TRUE(test::contains(outcome.err, part)) << outcome.err;
  };
  refuses({}, "MODEL_PATH");
  refuses({path("model")}, "OUTPUT");
  refuses({path("model"), path("model")}, "is a folder");
  refuses({path("model"), path("a")}, "expected an extension");
  refuses({path("nothing"), path("b.spz")}, "not found");
  refuses({path("model"), path("b.spz"), "--crop", "1,2"}, "--crop");
  refuses({path("model"), path("b.spz"), "--up", "w"}, "--up");
  refuses({path("model"), path("b.spz"), "--scale", "1,2,3"}, "--scale 1,2,3: expected a factor above 0");
  refuses({ply(), path("b.spz"), "--iteration", "20"}, "--iteration");
  write_splat_ply(path("empty.ply"), SplatCloud{});
  refuses({path("empty.ply"), path("b.spz")}, "no Gaussians");
  EXPECT_FALSE(fs::exists(path("b.spz")));
}

TEST_F(Export, SaysHowToGetTheProgramForOtherFormats) {
  const ScopedPath no_programs(path("."));
  const Outcome outcome = run_export({path("model"), path("a.sog")});
  EXPECT_EQ(outcome.exit_code, 2);
  EXPECT_TRUE(test::contains(outcome.err, "npm install -g @playcanvas/splat-transform")) << outcome.err;
}

TEST_F(Export, HandsOtherFormatsToTheProgramAndReadsThemBack) {
  const fs::path folder = *folder_ / "bin", program = folder / "splat-transform";
  fs::create_directory(folder);
  const auto install = [&](const std::string& script) {
    test::write_bytes(program, "#!/bin/sh\nfor to; do from=$last; last=$to; done\n" + script);
    fs::permissions(program, fs::perms::owner_all);
  };
  const ScopedPath first(folder.string() + ":/usr/bin:/bin");
  install("cp \"$from\" \"$to\"\n");
  const Outcome good = run_export({path("model"), path("b.sog")});
  ASSERT_EQ(good.exit_code, 0) << good.err;
  EXPECT_TRUE(test::contains(good.out, "0.00 dB lost")) << good.out;
  EXPECT_TRUE(test::same(test::read_bytes(path("b.sog")), test::read_bytes(ply())));
  const Outcome glb = run_export({path("model"), path("b.glb")});
  ASSERT_EQ(glb.exit_code, 0) << glb.err;
  EXPECT_TRUE(test::contains(glb.out, "not measured: splat-transform does not read .glb")) << glb.out;
  ASSERT_EQ(run_export({path("model"), path("b.compressed.ply")}).exit_code, 0);

  const Outcome loud = run_b3dgs({"export", path("model"), path("loud.sog"), "--device", "cpu"});
  ASSERT_EQ(loud.exit_code, 0) << loud.err;
  const std::size_t writes = loud.err.find("splat-transform writes loud.sog, which may take minutes\n"),
                    reads = loud.err.find("splat-transform reads loud.sog back\n"),
                    measures = loud.err.find("measuring PSNR on 2 views\n");
  ASSERT_NE(measures, std::string::npos) << loud.err;
  EXPECT_TRUE(writes < reads && reads < measures) << loud.err;

  install("case $to in *back.ply) echo nonsense >\"$to\" ;; *) cp \"$from\" \"$to\" ;; esac\n");
  const Outcome unmeasured = run_export({path("model"), path("e.sog")});
  EXPECT_EQ(unmeasured.exit_code, 0) << unmeasured.err;
  EXPECT_TRUE(test::contains(unmeasured.err, "e.sog is complete")) << unmeasured.err;
  EXPECT_TRUE(test::contains(unmeasured.out, "not measured: ")) << unmeasured.out;
  EXPECT_TRUE(test::same(test::read_bytes(path("e.sog")), test::read_bytes(ply())));

  install("echo 'x Error: no such thing' >&2; exit 3\n");
  const Outcome bad = run_export({path("model"), path("c.sog")});
  EXPECT_EQ(bad.exit_code, 2);
  EXPECT_TRUE(test::contains(bad.err, "exit code 3: Error: no such thing")) << bad.err;
  install("if [ $1$2$3$4 = -q-w-gcpu ]; then cp \"$from\" \"$to\"; else : >\"$to\"; exit 1; fi\n");
  EXPECT_EQ(run_export({path("model"), path("d.sog")}).exit_code, 0) << "again on the CPU";
  EXPECT_FALSE(fs::exists(path("c.sog")));
  for (const auto& entry : fs::directory_iterator(folder_->path())) {
    EXPECT_FALSE(test::contains(entry.path().string(), ".tmp")) << entry.path();
  }
}

TEST_F(Export, RemovesItsFilesWhenItIsStopped) {
  const fs::path folder = *folder_ / "bin2", out = *folder_ / "stopped";
  fs::create_directory(folder);
  fs::create_directory(out);
  test::write_bytes(folder / "splat-transform", "#!/bin/sh\ntouch '" + out.string() + "/started'\nsleep 100\n");
  fs::permissions(folder / "splat-transform", fs::perms::owner_all);
  const ScopedPath first(folder.string() + ":/usr/bin:/bin");
  test::RunOptions options;
  options.signal = SIGINT;
  options.signal_when = [&] { return fs::exists(out / "started"); };
  const Outcome outcome = run_b3dgs({"export", path("model"), (out / "a.sog").string(), "--device", "cpu"}, options);
  EXPECT_EQ(outcome.exit_code, 128 + SIGINT) << outcome.err;
  fs::remove(out / "started");
  EXPECT_TRUE(fs::is_empty(out));
}

// The real program, from PATH. scripts/check_exports.sh installs it and runs these tests.
class SplatTransform : public Export {
 protected:
  void SetUp() override {
    if (find_program("splat-transform").empty()) {
      GTEST_SKIP() << "splat-transform is not installed; scripts/check_exports.sh installs it in the build folder";
    }
  }
};

/// Tolerances of the attributes, apart from rotations, whose |dot product| with the expected ones is compared with 1.
struct Tolerances {
  double position, log_scale, color, sh, opacity, rotation;
};

void expect_same_splats(const SplatCloud& found, const SplatCloud& expected, const Tolerances& tolerance) {
  ASSERT_EQ(found.size(), expected.size());
  ASSERT_EQ(found.sh_degree, expected.sh_degree);
  const auto opacity = [](float logit) { return 1 / (1 + std::exp(-static_cast<double>(logit))); };
  for (std::size_t i = 0; i < expected.means.size(); ++i) {
    ASSERT_NEAR(found.means[i], expected.means[i], tolerance.position) << i;
    ASSERT_NEAR(found.log_scales[i], expected.log_scales[i], tolerance.log_scale) << i;
    ASSERT_NEAR(found.sh0[i], expected.sh0[i], tolerance.color) << i;
  }
  for (std::size_t i = 0; i < expected.shN.size(); ++i) ASSERT_NEAR(found.shN[i], expected.shN[i], tolerance.sh) << i;
  for (std::size_t i = 0; i < expected.logit_opacities.size(); ++i) {
    ASSERT_NEAR(opacity(found.logit_opacities[i]), opacity(expected.logit_opacities[i]), tolerance.opacity) << i;
    double dot = 0, found_squared = 0, squared = 0;
    for (std::size_t k = 4 * i; k < 4 * i + 4; ++k) {
      dot += static_cast<double>(found.quats[k]) * expected.quats[k];
      found_squared += static_cast<double>(found.quats[k]) * found.quats[k];
      squared += static_cast<double>(expected.quats[k]) * expected.quats[k];
    }
    ASSERT_NEAR(std::abs(dot) / std::sqrt(found_squared * squared), 1, tolerance.rotation) << i;
  }
}

TEST_F(SplatTransform, ReadsTheSameGaussiansFromOurSpz) {
  // A trained model has all rotations, and SH of degree 3.
  for (const int version : {3, 4}) {
    SCOPED_TRACE(version);
    write_spz(path("ours.spz"), read_splat_ply(ply()), kSpzShBits, version);
    const ChildResult result = run_program_lines({"splat-transform", "-q", "-w", path("ours.spz"), path("theirs.ply")},
                                                 [](const std::string&) {});
    ASSERT_TRUE(result.succeeded()) << describe(result);
    expect_same_splats(read_splat_ply(path("theirs.ply")), read_spz(path("ours.spz")),
                       {1e-6, 1e-5, 1e-5, 1e-6, 1e-5, 1e-6});
  }
}

TEST_F(SplatTransform, WritesSpzThatWeRead) {
  for (const int version : {3, 4}) {
    SCOPED_TRACE(version);
    const ChildResult result = run_program_lines(
        {"splat-transform", "-q", "-w", "--spz-version", std::to_string(version), ply(), path("theirs.spz")},
        [](const std::string&) {});
    ASSERT_TRUE(result.succeeded()) << describe(result);
    EXPECT_EQ(test::read_bytes(path("theirs.spz")).substr(0, 4) == "NGSP", version == 4);
    // A step of each attribute; SH have 4 bits.
    expect_same_splats(read_spz(path("theirs.spz")), read_splat_ply(ply()),
                       {1.0 / 4096, 1.0 / 16, 1 / 255.0 / 0.15, 1.0 / 8, 1 / 255.0, 1e-5});
  }
}

TEST_F(SplatTransform, WritesFormatsThatAreMeasured) {
  for (const std::string name : {"r.sog", "r.compressed.ply", "r.html"}) {
    const Outcome outcome = run_export({path("model"), path(name)});
    ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
    EXPECT_TRUE(test::contains(outcome.out, "(mean of 2 test views)")) << name << ": " << outcome.out;
  }
}

}  // namespace
}  // namespace b3dgs
