// Synthetic scenes: their distributions, their files, and reading by COLMAP.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <set>

#include "core/check.h"
#include "core/files/atomic_file.h"
#include "data_synth/synth_writer.h"
#include "model/formats/splat_formats.h"
#include "scene/scene.h"
#include "scene/view_image.h"
#include "support/expect_error.h"
#include "support/files.h"
#include "support/temp_dir.h"
#include "train/gaussians/gaussian_model.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using test::read_bytes;

SynthConfig small(const std::string& scene, const fs::path& output) {
  SynthConfig config;
  config.scene = scene;
  config.output = output.string();
  config.points = 500;
  config.views = 4;
  config.width = 48;
  config.height = 32;
  return config;
}

void write(const SynthConfig& config) {
  write_synth_scene(config, make_scene(config));
}

/// Returns the relative path and content of every file except synth.json, which contains the output folder, and the
/// list of own files.
std::vector<std::pair<std::string, std::string>> contents(const fs::path& folder) {
  std::vector<std::pair<std::string, std::string>> files;
  for (const fs::directory_entry& entry : fs::recursive_directory_iterator(folder)) {
    if (!entry.is_regular_file() || entry.path().filename() == "synth.json" ||
        entry.path().filename() == ".b3dgs-files") {  // contains times
      continue;
    }
    files.emplace_back(fs::relative(entry.path(), folder).string(), read_bytes(entry.path()));
  }
  std::sort(files.begin(), files.end());
  return files;
}

std::vector<double> depths(const SynthScene& scene) {
  std::vector<double> z;
  for (std::size_t i = 2; i < scene.points.positions.size(); i += 3) z.push_back(scene.points.positions[i]);
  return z;
}

/// Kolmogorov-Smirnov distance between the distribution of u and the uniform distribution on [0, 1].
double distance_from_uniform(std::vector<double> u) {
  std::sort(u.begin(), u.end());
  double largest = 0;
  const double n = static_cast<double>(u.size());
  for (std::size_t i = 0; i < u.size(); ++i) {
    const double below = static_cast<double>(i) / n;
    largest = std::max({largest, std::abs(u[i] - below), std::abs(u[i] - below - 1 / n)});
  }
  return largest;
}

class Synth : public ::testing::TestWithParam<const char*> {
 protected:
  test::TempDir folder_;
};

TEST_P(Synth, TheSameSeedGivesTheSameBytes) {
  write(small(GetParam(), folder_.path() / "a"));
  write(small(GetParam(), folder_.path() / "b"));
  EXPECT_EQ(contents(folder_.path() / "a"), contents(folder_.path() / "b"));
}

TEST_P(Synth, AnotherSeedGivesAnotherScene) {
  SynthConfig config = small(GetParam(), "");
  const SynthScene a = make_scene(config);
  config.seed = 1;
  EXPECT_NE(a.truth.means, make_scene(config).truth.means);
}

TEST_P(Synth, LoadsAsAScene) {
  for (const char* format : {"binary", "text"}) {
    SynthConfig config = small(GetParam(), folder_.path() / format);
    config.format = format;
    const SynthScene made = make_scene(config);
    write_synth_scene(config, made);
    SceneOptions options;
    options.source_path = config.output;
    options.frame = CoordinateFrame{};
    const Scene scene = load_scene(options);
    ASSERT_EQ(scene.train.size(), made.cameras.size());
    EXPECT_EQ(scene.points.positions, made.points.positions);
    EXPECT_EQ(scene.points.colors, made.points.colors);
    for (std::size_t i = 0; i < made.cameras.size(); ++i) {
      const Camera &loaded = scene.train[i].camera, &known = made.cameras[i];
      EXPECT_EQ(loaded.width, known.width);
      EXPECT_NEAR(loaded.fx, known.fx, 1e-9);
      for (std::size_t k = 0; k < 3; ++k) EXPECT_NEAR(loaded.center()[k], known.center()[k], 1e-9);
      EXPECT_EQ(scene.train[i].image->read()->pixels, render_truth(made.truth, known).pixels);
    }
  }
}

TEST_P(Synth, ExposureJitterGivesEachImageGainsOfItsOwn) {
  SynthConfig config = small(GetParam(), folder_.path() / "same");
  write(config);
  config.output = (folder_.path() / "jittered").string();
  config.exposure_jitter = 0.3;
  write(config);
  SceneOptions options;
  options.source_path = (folder_.path() / "same").string();
  const Scene same = load_scene(options);
  options.source_path = config.output;
  const Scene jittered = load_scene(options);
  EXPECT_EQ(jittered.points.positions, same.points.positions);
  std::set<double> gains;
  for (std::size_t i = 0; i < same.train.size(); ++i) {
    const auto before = same.train[i].image->read(), after = jittered.train[i].image->read();
    for (std::size_t c = 0; c < 3; ++c) {
      double sum = 0, new_sum = 0;
      for (std::size_t p = c; p < before->pixels.size(); p += 3) {
        if (after->pixels[p] == 255) continue;  // clipped
        sum += before->pixels[p];
        new_sum += after->pixels[p];
      }
      const double gain = new_sum / sum;
      EXPECT_GE(gain, std::exp(-0.46)) << i;
      EXPECT_LE(gain, std::exp(0.46)) << i;
      gains.insert(gain);
      for (std::size_t p = c; p < before->pixels.size(); p += 3) {
        EXPECT_NEAR(after->pixels[p], std::min(255.0, gain * before->pixels[p]), 1.5) << "one gain for all pixels";
      }
    }
  }
  EXPECT_EQ(gains.size(), 3 * same.train.size());
}

TEST_P(Synth, TruthPlyHoldsTheTrueGaussians) {
  const SynthConfig config = small(GetParam(), folder_.path() / "scene");
  const SynthScene made = make_scene(config);
  write_synth_scene(config, made);
  const SplatCloud read = read_splat_ply(fs::path(config.output) / "truth.ply");
  EXPECT_EQ(read.means, made.truth.means);
  EXPECT_EQ(read.shN, made.truth.shN);
  EXPECT_EQ(read.size(), made.truth.size());
  EXPECT_GE(read.size(), config.points / 2);
}

TEST_P(Synth, ImagesAreMostlyCoveredAndHaveContrast) {
  const SynthConfig config = small(GetParam(), "");
  const SynthScene made = make_scene(config);
  for (const Camera& camera : made.cameras) {
    const Image8 image = render_truth(made.truth, camera);
    const auto dark = std::count_if(image.pixels.begin(), image.pixels.end(), [](std::uint8_t v) { return v < 5; });
    EXPECT_LT(static_cast<double>(dark), 0.6 * static_cast<double>(image.pixels.size()));
    const auto [least, most] = std::minmax_element(image.pixels.begin(), image.pixels.end());
    EXPECT_GT(*most - *least, 50);
  }
}

TEST_P(Synth, ColmapAcceptsIt) {
  if (std::system("command -v colmap > /dev/null 2>&1") != 0) GTEST_SKIP() << "colmap is not installed";
  for (const char* format : {"binary", "text"}) {
    SynthConfig config = small(GetParam(), folder_.path() / format);
    config.format = format;
    write(config);
    const std::string log = (folder_.path() / "log").string();
    const std::string command =
        "QT_QPA_PLATFORM=offscreen colmap model_analyzer --path " + config.output + "/sparse/0 > " + log + " 2>&1";
    EXPECT_EQ(std::system(command.c_str()), 0);
    EXPECT_NE(read_bytes(log).find("Registered images: 4"), std::string::npos) << read_bytes(log);
  }
}

INSTANTIATE_TEST_SUITE_P(Scenes, Synth, ::testing::Values("orbit", "street"),
                         [](const auto& info) { return info.param; });

TEST(SynthLens, IsWrittenAndReadBack) {
  for (const char* lens : {"OPENCV", "OPENCV_FISHEYE", "THIN_PRISM_FISHEYE", "EQUIRECTANGULAR"}) {
    SCOPED_TRACE(lens);
    const test::TempDir folder;
    SynthConfig config = small("orbit", folder / "scene");
    config.lens = lens;
    config.width = 64;
    const SynthScene scene = make_scene(config);
    write_synth_scene(config, scene);
    SceneOptions options;
    options.source_path = config.output;
    options.lenses = "native";
    options.frame = CoordinateFrame{};
    const Scene loaded = load_scene(options);
    const LensParams<double>&expected = scene.cameras[0].lens, &found = loaded.train.at(0).camera.lens;
    EXPECT_EQ(found.kind, expected.kind);
    EXPECT_TRUE(std::equal(found.k, found.k + kLensCoefficients, expected.k));
    EXPECT_EQ(render_truth(scene.truth, scene.cameras[0]).pixels, loaded.train.at(0).image->read()->pixels);
  }
}

TEST(SynthFolder, ASyntheticSceneIsReplaced) {
  test::TempDir folder;
  SynthConfig config = small("orbit", folder.path() / "scene");
  write(config);
  config.views = 2;
  write(config);
  EXPECT_EQ(std::distance(fs::directory_iterator(folder.path() / "scene" / "images"), fs::directory_iterator()), 2);
}

TEST(SynthFolder, OtherFilesInItStayWhenASceneIsReplaced) {
  const test::TempDir temporary;
  const fs::path folder = temporary.path() / "scene";
  SynthConfig config = small("orbit", folder);
  config.views = 6;
  write(config);
  const std::vector<fs::path> others{folder / "images" / "IMG_0001.png", folder / "images" / "00000.png.txt",
                                     folder / "sparse" / "0" / "notes.txt", folder / "sparse" / "1" / "cameras.bin",
                                     folder / "masks" / "00000.png"};
  for (const fs::path& other : others) test::write_bytes(other, "mine");
  // Files at paths of the next scene: one that was changed, and one that was added.
  const std::vector<fs::path> in_the_way{folder / "images" / "00001.png", folder / "sparse" / "0" / "images.txt"};
  for (const fs::path& other : in_the_way) test::write_bytes(other, "mine");
  config.views = 4;
  config.format = "text";
  write(config);
  for (const fs::path& other : others) EXPECT_EQ(read_bytes(other), "mine") << other;
  for (const fs::path& other : in_the_way) {
    EXPECT_EQ(read_bytes(other.string() + ".previous"), "mine");
    EXPECT_NE(read_bytes(other), "mine");
  }
  EXPECT_FALSE(fs::exists(folder / "images" / "00005.png")) << "an image of the scene before";
  EXPECT_FALSE(fs::exists(folder / "sparse" / "0" / "images.bin")) << "the model of the scene before";
}

TEST(SynthFolder, AfterAFailureTheSceneIsGoneAndFilesOfOthersStay) {
  const test::TempDir temporary;
  const fs::path folder = temporary.path() / "scene";
  const SynthConfig config = small("orbit", folder);
  const SynthScene made = make_scene(config);
  const auto fail = [&] {
    write_synth_scene(config, made, [](std::size_t, std::size_t) { io_error("no space left"); });
  };
  EXPECT_THROW(fail(), IoError);
  EXPECT_FALSE(fs::exists(folder)) << "it was new";

  write(config);
  test::write_bytes(folder / "images" / "IMG_0001.png", "mine");
  EXPECT_THROW(fail(), IoError);
  EXPECT_EQ(read_bytes(folder / "images" / "IMG_0001.png"), "mine");
  EXPECT_FALSE(fs::exists(folder / "images" / "00000.png"));
  EXPECT_FALSE(fs::exists(folder / "sparse"));
  write(config);  // the folder is still a synthetic scene
  EXPECT_EQ(read_bytes(folder / "images" / "IMG_0001.png"), "mine");
}

TEST(SynthFolder, AnyOtherFolderIsRejected) {
  test::TempDir folder;
  write_file(folder.path() / "sparse" / "0" / "cameras.bin", "precious");
  EXPECT_THROW(write(small("orbit", folder.path())), InputError);
  EXPECT_EQ(read_bytes(folder.path() / "sparse" / "0" / "cameras.bin"), "precious");
}

TEST(Street, DepthsAreLogUniform) {
  SynthConfig config = small("street", "");
  config.points = 20000;
  std::vector<double> u;
  for (const double z : depths(make_scene(config))) u.push_back(std::log(z / 3) / std::log(400.0 / 3));
  EXPECT_LT(distance_from_uniform(u), 1.63 / std::sqrt(20000.0));  // the 1 % critical value
}

TEST(Street, PointsAreThoseOfTheMeasuredFigures) {
  // docs/benchmarks.md has results of `bench street`, which uses these points.
  for (const char* truth : {"surfaces", "points"}) {
    SynthConfig config = small("street", "");
    config.truth = truth;
    const std::vector<float> positions = make_scene(config).points.positions;
    const float expected[]{-9.0541057586669922f, -3.498115062713623f, 11.095651626586914f};
    for (std::size_t k = 0; k < 3; ++k) EXPECT_FLOAT_EQ(positions[positions.size() - 3 + k], expected[k]) << k;
  }
}

/// Returns the Gaussians that training starts from, but with the opacity of a surface.
SplatCloud solid_points(const SynthScene& scene) {
  SplatCloud cloud = splats_from_points(scene.points, 0);
  std::fill(cloud.logit_opacities.begin(), cloud.logit_opacities.end(), logit(0.8));
  return cloud;
}

/// Returns the PSNR between renders of two models, dB.
double psnr_of(const SplatCloud& a, const SplatCloud& b, const Camera& camera) {
  const Image8 first = render_truth(a, camera), second = render_truth(b, camera);
  double sum = 0;
  for (std::size_t i = 0; i < first.pixels.size(); ++i) {
    const double difference = (static_cast<double>(first.pixels[i]) - second.pixels[i]) / 255;
    sum += difference * difference / static_cast<double>(first.pixels.size());
  }
  return -10 * std::log10(sum);
}

TEST(Street, TrainingHasToFindWhatTheImagesShow) {
  SynthConfig config = small("street", "");
  config.points = 3000;
  config.width = 240;
  config.height = 135;
  const SynthScene made = make_scene(config);
  const auto n = static_cast<std::size_t>(made.truth.size());
  std::set<std::array<float, 3>> points;
  for (std::size_t i = 0; i < made.points.positions.size(); i += 3) {
    points.insert({made.points.positions[i], made.points.positions[i + 1], made.points.positions[i + 2]});
  }
  std::size_t n_at_points = 0, n_round = 0, n_solid = 0;
  for (std::size_t i = 0; i < n; ++i) {
    const float *mean = &made.truth.means[3 * i], *scale = &made.truth.log_scales[3 * i];
    n_at_points += points.count({mean[0], mean[1], mean[2]});
    n_round += *std::max_element(scale, scale + 3) - *std::min_element(scale, scale + 3) < std::log(2.0);
    n_solid += made.truth.logit_opacities[i] > logit(0.8);
  }
  EXPECT_EQ(n_at_points, 0u) << "positions differ";
  EXPECT_EQ(n_round, 0u) << "the Gaussians are anisotropic";
  EXPECT_GT(n_solid, n / 10) << "opacities vary";
  EXPECT_LT(n_solid, n / 2);
  EXPECT_LT(psnr_of(solid_points(made), made.truth, made.cameras[0]), 25)
      << "opaque points do not reproduce the images";

  config.truth = "points";
  const SynthScene given = make_scene(config);
  EXPECT_EQ(given.truth.means, given.points.positions);
  EXPECT_GT(psnr_of(solid_points(given), given.truth, given.cameras[0]), 60) << "with truth=points they do";
}

TEST(Street, SkewMovesPointsTowardsTheHorizon) {
  SynthConfig config = small("street", "");
  config.points = 20000;
  config.skew = 2;
  std::vector<double> u;
  for (const double z : depths(make_scene(config))) u.push_back(std::pow(std::log(z / 3) / std::log(400.0 / 3), 2));
  EXPECT_LT(distance_from_uniform(u), 1.63 / std::sqrt(20000.0));
}

TEST(Street, AThirdIsRoadAndTheRestFacades) {
  SynthConfig config = small("street", "");
  config.points = 9000;
  const SynthScene scene = make_scene(config);
  int n_road = 0;
  for (std::size_t i = 0; i < 9000; ++i) {
    const double x = scene.points.positions[3 * i], y = scene.points.positions[3 * i + 1];
    const bool is_road = std::abs(x) < 8 && std::abs(y - 1.6) < 0.15;
    n_road += is_road;
    if (is_road) continue;
    EXPECT_GE(std::abs(x), 8);
    EXPECT_LE(y, 1.6f);
    EXPECT_GE(y, 1.6 - 9);
  }
  EXPECT_EQ(n_road, 3000);
}

TEST(Street, CamerasDriveForward) {
  SynthConfig config = with_scene_defaults([] {
    SynthConfig c;
    c.scene = "street";
    return c;
  }());
  EXPECT_EQ(config.width, 960);
  EXPECT_EQ(config.height, 540);
  config.points = 100;
  const SynthScene scene = make_scene(config);
  EXPECT_EQ(scene.cameras[0].fx, 800);
  EXPECT_EQ(scene.cameras[0].fy, 800);
  EXPECT_EQ(scene.cameras[0].cx, 480);
  EXPECT_EQ(scene.cameras[0].cy, 270);
  for (std::size_t i = 0; i < scene.cameras.size(); ++i) {
    EXPECT_NEAR(scene.cameras[i].center()[0], 0, 1e-12);
    EXPECT_NEAR(scene.cameras[i].center()[1], 0, 1e-12);
    EXPECT_NEAR(scene.cameras[i].center()[2], static_cast<double>(i), 1e-12);
  }
}

TEST(Orbit, GaussiansLieFlatOnTheirSurfaces) {
  const SynthScene scene = make_scene(small("orbit", ""));
  int n_ground = 0;
  for (std::size_t i = 0; i < static_cast<std::size_t>(scene.truth.size()); ++i) {
    if (std::abs(scene.truth.means[3 * i + 2]) > 1e-6) continue;  // the ground is at z = 0
    ++n_ground;
    // The third axis is the thin one and points up. The rotation keeps z, up to sign.
    const float* q = &scene.truth.quats[4 * i];
    const double up = 1 - 2.0 * (q[1] * q[1] + q[2] * q[2]);
    EXPECT_NEAR(up, 1, 1e-5);
    EXPECT_LT(scene.truth.log_scales[3 * i + 2], scene.truth.log_scales[3 * i + 1]);
  }
  EXPECT_GT(n_ground, 100);
}

TEST(Orbit, PointsAreNearGaussiansAndHalfAsMany) {
  SynthConfig config = small("orbit", "");
  config.points = 2000;
  const SynthScene scene = make_scene(config);
  EXPECT_NEAR(static_cast<double>(scene.points.size()), 1000, 100);
  for (std::int64_t p = 0; p < scene.points.size(); p += 50) {
    double nearest = 1e9;
    for (std::int64_t g = 0; g < scene.truth.size(); ++g) {
      double squared = 0;
      for (std::int64_t k = 0; k < 3; ++k) {
        const double d = scene.points.positions[static_cast<std::size_t>(3 * p + k)] -
                         scene.truth.means[static_cast<std::size_t>(3 * g + k)];
        squared += d * d;
      }
      nearest = std::min(nearest, squared);
    }
    EXPECT_LT(std::sqrt(nearest), 0.06);  // noise of 0.01 per coordinate
  }
}

TEST(Orbit, EveryCameraLooksAtTheMiddle) {
  const SynthScene scene = make_scene(small("orbit", ""));
  for (const Camera& camera : scene.cameras) {
    const std::array<double, 9>& r = camera.cam_from_world.rotation;
    const std::array<double, 3>& t = camera.cam_from_world.translation;
    const double height = 0.35;  // of the target, on the z axis
    EXPECT_NEAR(r[2] * height + t[0], 0, 1e-9);
    EXPECT_NEAR(r[5] * height + t[1], 0, 1e-9);
    EXPECT_GT(r[8] * height + t[2], 3);
    EXPECT_LT(r[5], 0);  // the world's up is the image's up: -y
  }
}

}  // namespace
}  // namespace b3dgs
