// b3dgs bench: tables, statistics, synthetic scenes, and the program.
#include <gtest/gtest.h>
#include <torch/types.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <csignal>
#include <filesystem>
#include <limits>
#include <nlohmann/json.hpp>

#include "app/bench/bench_report.h"
#include "app/bench/bench_scenes.h"
#include "core/check.h"
#include "data_synth/synth_scene.h"
#include "raster/kernels.h"
#include "support/expect_error.h"
#include "support/files.h"
#include "support/run_program.h"
#include "support/temp_dir.h"
#include "train/evaluate.h"
#include "train/gaussians/gaussian_model.h"

namespace b3dgs {
namespace {

using nlohmann::json;
using test::Outcome;
using test::run_b3dgs;

TEST(BenchReport, SummarizesByMedianAndRange) {
  const Timing timing = summarize({5, 1, 9, 2, 3});
  EXPECT_EQ(timing.median_ms, 3);
  EXPECT_EQ(timing.min_ms, 1);
  EXPECT_EQ(timing.max_ms, 9);
}

TEST(BenchReport, ListStatisticsOfKnownLists) {
  const auto even = list_statistics(torch::full({100}, 7, torch::kInt64));
  EXPECT_EQ(even["mean"], 7);
  EXPECT_EQ(even["max"], 7);
  EXPECT_NEAR(even["gini"].get<double>(), 0, 1e-12);

  torch::Tensor one = torch::zeros({100}, torch::kInt64);
  one[37] = 1000;
  const auto crowded = list_statistics(one);
  EXPECT_EQ(crowded["median"], 0);
  EXPECT_EQ(crowded["pairs"], 1000);
  EXPECT_NEAR(crowded["gini"].get<double>(), 0.99, 1e-12);  // 1 - 1 / n

  EXPECT_EQ(list_statistics(torch::zeros({3}, torch::kInt64))["gini"], 0) << "empty lists are evenly distributed";
}

TEST(BenchReport, DifferencesAreRelativeToTheLargestMagnitude) {
  const auto values = [](float a, float b) { return torch::tensor({a, b}); };
  EXPECT_EQ(relative_difference(values(0.5f, -4), values(1, -4)), 0.125);
  EXPECT_EQ(relative_difference(values(0.5f, -4), values(1, -4), 5), 0.1);
  EXPECT_EQ(relative_difference(values(0, 0), values(0, 0)), 0);
  EXPECT_EQ(relative_difference(torch::zeros({5, 0, 3}), torch::zeros({5, 0, 3})), 0) << "SH degree 0";
  EXPECT_EQ(relative_difference(values(0, 1), values(0, 0)), HUGE_VAL);
  EXPECT_TRUE(std::isnan(relative_difference(values(1, std::numeric_limits<float>::quiet_NaN()), values(1, 2))));
}

TEST(BenchReport, ComparesEveryRowWithTheFirst) {
  testing::internal::CaptureStdout();
  ComparisonTable table("forward kernel");
  const auto values = [](float a, float b) { return torch::tensor({a, b}); };
  table.add({"naive", {6, 5, 7}, values(0.5f, 1), {{values(10, -20)}, {values(1, 1)}}});
  table.add({"fast", {2, 2, 2}, values(0.5f, 0.75f), {{values(10, -19)}, {values(1, 0.9f)}}});
  const std::string printed = testing::internal::GetCapturedStdout();
  const json rows = table.rows();
  ASSERT_EQ(rows.size(), 2u);
  EXPECT_EQ(rows[0]["kernel"], "naive");
  EXPECT_EQ(rows[0]["image_difference"], 0);
  EXPECT_EQ(rows[0]["gradient_difference"], 0);
  EXPECT_EQ(rows[1]["speedup"], 3);
  EXPECT_EQ(rows[1]["image_difference"], 0.25);
  EXPECT_NEAR(rows[1]["gradient_difference"].get<double>(), 0.1, 1e-6) << "the largest of the parameters";
  for (const char* part : {"3.00", "2.5e-01", "1.0e-01"}) {
    EXPECT_NE(printed.find(part), std::string::npos) << printed;
  }
}

TEST(BenchReport, ColumnsThatWereNotMeasuredAreAbsent) {
  testing::internal::CaptureStdout();
  ComparisonTable table("forward kernel");
  table.add({"naive", {1, 1, 1}, torch::tensor({0.5f})});
  EXPECT_EQ(testing::internal::GetCapturedStdout().find("grad. diff."), std::string::npos);
  EXPECT_FALSE(table.rows()[0].contains("gradient_difference"));
}

constexpr int kWidth = 480, kHeight = 270;

/// Returns the distances of visible points from the image centre, max(|x|, |y|) in units of half the image size,
/// ascending.
std::vector<double> distances(const std::vector<float>& positions, double focal) {
  std::vector<double> visible;
  for (std::size_t i = 0; i < positions.size(); i += 3) {
    const double scale = focal / positions[i + 2];
    const double distance =
        std::max(std::abs(scale * positions[i]) / (0.5 * kWidth), std::abs(scale * positions[i + 1]) / (0.5 * kHeight));
    if (distance < 1) visible.push_back(distance);
  }
  std::sort(visible.begin(), visible.end());
  return visible;
}

std::vector<double> spread_distances(double skew) {
  BenchRun run;
  run.width = kWidth;
  run.height = kHeight;
  return distances(make_spread_scene({20000, skew, 0}, run).cloud.means, 1000);
}

/// Kolmogorov-Smirnov statistic: largest distance between the cumulative distributions of two samples.
double distance_of_distributions(const std::vector<double>& a, const std::vector<double>& b) {
  double largest = 0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    const auto below = static_cast<double>(std::lower_bound(b.begin(), b.end(), a[i]) - b.begin());
    largest = std::max(largest, std::abs(below / static_cast<double>(b.size()) -
                                         static_cast<double>(i) / static_cast<double>(a.size())));
  }
  return largest;
}

TEST(SpreadScene, WithoutSkewIsEven) {
  std::vector<double> areas = spread_distances(0);
  for (double& value : areas) value *= value;
  std::vector<double> even;
  for (int i = 0; i < 20000; ++i) even.push_back((i + 0.5) / 20000);
  EXPECT_LT(distance_of_distributions(areas, even), 1.63 / std::sqrt(20000.0));  // exceeded by one in a hundred seeds
}

TEST(SpreadScene, SkewOfOneHasTheDistributionOfStreet) {
  SynthConfig config;
  config.scene = "street";
  config.points = 30000;
  config.views = 1;
  config.width = kWidth;
  config.height = kHeight;
  const SynthScene street = make_scene(config);
  const std::vector<double> expected = distances(street.points.positions, street.cameras.front().fx);
  EXPECT_LT(distance_of_distributions(spread_distances(1), expected), 0.03);
  EXPECT_GT(distance_of_distributions(spread_distances(0.75), expected), 0.1);
}

TEST(SpreadScene, SkewChangesOnlyPositionsTowardsTheCentre) {
  double before = 1;
  for (const double skew : {0.0, 0.5, 0.999999999999, 1.0, 1.5, 2.0}) {
    const std::vector<double> values = spread_distances(skew);
    ASSERT_GT(values.size(), 19990u) << "nearly all are in the image";
    const double median = values[values.size() / 2];
    EXPECT_LE(median, before + 1e-6) << skew;
    before = median;
  }
  const SplatCloud even = make_spread_scene({100, 0, 1}, {}).cloud, skewed = make_spread_scene({100, 1, 1}, {}).cloud;
  EXPECT_EQ(even.log_scales, skewed.log_scales);
  EXPECT_EQ(even.logit_opacities, skewed.logit_opacities);
  EXPECT_EQ(even.shN, skewed.shN);
  EXPECT_NE(even.means, skewed.means);
}

TEST(SpreadScene, IsTheSceneOfThePublishedBenchmarks) {
  // docs/lab/kernels.md has measurements of `spread`. All values come from one sequence of random numbers, so an
  // additional or missing number changes the last Gaussian.
  const SplatCloud even = make_spread_scene({1000, 0, 1}, {}).cloud, skewed = make_spread_scene({1000, 1, 1}, {}).cloud;
  const auto expect_last = [](const std::vector<float>& values, const std::vector<float>& expected) {
    const std::vector<float> last(values.end() - static_cast<std::ptrdiff_t>(expected.size()), values.end());
    for (std::size_t i = 0; i < expected.size(); ++i) EXPECT_FLOAT_EQ(last[i], expected[i]) << i;
  };
  expect_last(even.means, {-2.60978079f, -0.933099985f, 5.48544502f});
  expect_last(skewed.means, {-2.47616434f, -0.885326803f, 5.48544502f});
  expect_last(even.log_scales, {-4.84593725f, -5.25007868f, -4.80075264f});
  expect_last(even.quats, {-1.86022198f, 0.512197018f, -0.0145723531f, 0.750941515f});
  expect_last(even.logit_opacities, {2.9392674f});
  expect_last(even.sh0, {-0.327048838f, 1.495785f, 0.303996891f});
  expect_last(even.shN, {-0.0906873271f});
}

/// The scene of a first iteration, projected to the screen.
struct FlatScene {
  PointCloud points;           // px, at depth 0
  std::vector<double> sigmas;  // px
  /// Indices of Gaussians by distance from the image centre, in ten groups of equal size.
  std::array<std::vector<std::size_t>, 10> tenths;
  /// Largest distance in each group, in units of half the image size.
  std::array<double, 10> ends;
};

FlatScene flat_first_iteration(double skew) {
  BenchRun run;
  run.width = kWidth;
  run.height = kHeight;
  constexpr std::size_t kPoints = 100000;
  const BenchScene scene = make_spread_scene({kPoints, skew, 0, SpreadState::kFirstIteration}, run);
  FlatScene flat;
  std::vector<std::pair<double, std::size_t>> by_distance;
  for (std::size_t i = 0; i < kPoints; ++i) {
    const double scale = scene.view.fx / scene.cloud.means[3 * i + 2];
    const double x = scale * scene.cloud.means[3 * i], y = scale * scene.cloud.means[3 * i + 1];
    flat.points.positions.insert(flat.points.positions.end(), {static_cast<float>(x), static_cast<float>(y), 0.0f});
    flat.points.colors.insert(flat.points.colors.end(), 3, std::uint8_t{0});
    flat.sigmas.push_back(scale * std::exp(scene.cloud.log_scales[3 * i]));
    by_distance.emplace_back(std::max(std::abs(x) / (0.5 * kWidth), std::abs(y) / (0.5 * kHeight)), i);
  }
  std::sort(by_distance.begin(), by_distance.end());
  for (std::size_t i = 0; i < kPoints; ++i) {
    const std::size_t tenth = i / (kPoints / 10);
    flat.tenths[tenth].push_back(by_distance[i].second);
    flat.ends[tenth] = by_distance[i].first;
  }
  return flat;
}

TEST(SpreadScene, SizesOfAFirstIterationFollowFromTheDensityOnTheScreen) {
  for (const double skew : {0.0, 0.5, 1.0}) {
    const FlatScene flat = flat_first_iteration(skew);
    double begin = 0, mean_before = 0;
    for (std::size_t tenth = 0; tenth < 10; ++tenth) {
      // A Gaussian of size 0.729 / sqrt(density) covers an area of 1 / density = (size / 0.729)^2, and those of a ring
      // together cover the ring. The sum of 10,000 such areas has a standard deviation of about 1 %.
      double area = 0, mean = 0;
      for (const std::size_t row : flat.tenths[tenth]) {
        area += std::pow(flat.sigmas[row] / 0.729, 2);
        mean += flat.sigmas[row] / static_cast<double>(flat.tenths[tenth].size());
      }
      const double end = flat.ends[tenth];
      EXPECT_NEAR(area / ((end * end - begin * begin) * kWidth * kHeight), 1, 0.04) << skew << ", tenth " << tenth;
      EXPECT_GE(mean, mean_before * (1 - 1e-6)) << skew << ": sizes decrease towards the centre";
      begin = end;
      mean_before = mean;
    }
    const double smallest = *std::min_element(flat.sigmas.begin(), flat.sigmas.end());
    const double largest = *std::max_element(flat.sigmas.begin(), flat.sigmas.end());
    // From the edge to the core of 1/20, the density grows by 20^(2 skew).
    EXPECT_NEAR(largest / smallest, std::pow(20, skew), 0.01 * std::pow(20, skew));
  }
}

TEST(SpreadScene, AFirstIterationIsInitializedAsInTraining) {
  const FlatScene flat = flat_first_iteration(1);
  const SplatCloud trained_from = splats_from_points(flat.points, 0);
  for (const std::vector<std::size_t>& tenth : flat.tenths) {
    double log_ratio = 0;
    for (const std::size_t row : tenth) {
      log_ratio += (std::log(flat.sigmas[row]) - trained_from.log_scales[3 * row]) / static_cast<double>(tenth.size());
    }
    // The geometric means differ by 1 % where the density is constant.
    EXPECT_NEAR(std::exp(log_ratio), 1, 0.03);
  }
  const SplatCloud cloud = make_spread_scene({100, 1, 2, SpreadState::kFirstIteration}, {}).cloud;
  EXPECT_EQ(cloud.logit_opacities, std::vector<float>(100, std::log(0.1f / 0.9f)));
  EXPECT_EQ(cloud.shN, std::vector<float>(100 * 3 * 8, 0.0f));
  for (std::size_t i = 0; i < 100; ++i) {
    EXPECT_EQ(cloud.log_scales[3 * i], cloud.log_scales[3 * i + 1]);
    EXPECT_EQ(cloud.log_scales[3 * i], cloud.log_scales[3 * i + 2]);
    EXPECT_EQ(cloud.quats[4 * i], 1);
  }
}

class BenchProgram : public ::testing::Test {
 protected:
  std::string path(const char* name) const { return (folder_ / name).string(); }

  /// Runs `b3dgs bench WORDS` and returns its JSON.
  json bench(std::vector<std::string> words) const {
    words.insert(words.begin(), "bench");
    words.insert(words.end(), {"--repeat", "1", "--device", "cpu", "--json", path("report.json")});
    const Outcome outcome = run_b3dgs(words);
    EXPECT_EQ(outcome.exit_code, 0) << outcome.err;
    const json report = json::parse(test::read_bytes(path("report.json")));
    std::filesystem::remove(path("report.json"));  // benchmarks do not overwrite it
    return report;
  }

  test::TempDir folder_;
};

TEST_F(BenchProgram, SweepTimesEveryNumberAndSkew) {
  const json report = bench({"sweep", "--points", "300", "900", "--skew", "0", "1", "--width", "96", "--height", "64"});
  ASSERT_EQ(report["cells"].size(), 4u);
  for (const json& cell : report["cells"]) {
    ASSERT_EQ(cell["kernels"].size(), kForwardKernels.size());
    const auto fastest = std::min_element(cell["kernels"].begin(), cell["kernels"].end(),
                                          [](const json& a, const json& b) { return a["median_ms"] < b["median_ms"]; });
    EXPECT_EQ(cell["fastest"], (*fastest)["kernel"]);
  }
  EXPECT_EQ(report["cells"][1]["skew"], 1);
  EXPECT_EQ(report["cells"][3]["points"], 900);
  EXPECT_GT(report["cells"][3]["lists"]["gini"], report["cells"][2]["lists"]["gini"]);
  EXPECT_GT(report["cells"][2]["lists"]["pairs"], report["cells"][0]["lists"]["pairs"]);
  EXPECT_LT(report["cells"][2]["lists"]["pairs"], 2.5 * report["cells"][0]["lists"]["pairs"].get<double>())
      << "three times as many Gaussians are smaller";

  const Outcome empty = run_b3dgs({"bench", "sweep", "--skew"});
  EXPECT_EQ(empty.exit_code, 2);
  EXPECT_NE(empty.err.find("--skew needs at least one value"), std::string::npos) << empty.err;
}

TEST_F(BenchProgram, ReplacesNoFile) {
  std::ofstream(path("mine.json")) << "mine";
  for (const std::vector<std::string>& words : std::vector<std::vector<std::string>>{
           {"bench", "spread"}, {"bench", "sweep"}, {"bench", "step", path("scene")}}) {
    std::vector<std::string> with_json = words;
    with_json.insert(with_json.end(), {"--device", "cpu", "--json", path("mine.json")});
    const Outcome outcome = run_b3dgs(with_json);
    EXPECT_EQ(outcome.exit_code, 2) << words.back();
    EXPECT_NE(outcome.err.find(path("mine.json") + " exists; name another file"), std::string::npos) << outcome.err;
  }
  EXPECT_EQ(test::read_bytes(path("mine.json")), "mine");
}

TEST_F(BenchProgram, AnInterruptedSweepKeepsItsResults) {
  const auto n_cells = [&]() -> std::size_t {
    if (!std::filesystem::exists(path("report.json"))) return 0;
    return json::parse(test::read_bytes(path("report.json")))["cells"].size();
  };
  test::RunOptions options;
  options.signal = SIGINT;
  options.signal_when = [&] { return n_cells() > 0; };
  std::vector<std::string> words{"bench", "sweep",    "--points", "300",      "--width", "96",     "--height",
                                 "64",    "--repeat", "1000",     "--device", "cpu",     "--json", path("report.json"),
                                 "--skew"};
  // There are far more than can be timed before the signal arrives, even on a busy machine.
  for (int i = 0; i < 100; ++i) words.push_back(std::to_string(0.01 * i));
  const Outcome ended = run_b3dgs(words, options);
  EXPECT_EQ(ended.exit_code, 130);
  EXPECT_GE(n_cells(), 1u);
  EXPECT_GE(std::count(ended.out.begin(), ended.out.end(), '\n'), 3) << ended.out;
}

TEST_F(BenchProgram, AModelAndItsPlyWithCamerasAreTheSameScene) {
  ASSERT_EQ(run_b3dgs({"synth", "orbit", path("scene"), "--points", "300", "--views", "3", "--width", "48", "--height",
                       "32", "--quiet"})
                .exit_code,
            0);
  ASSERT_EQ(run_b3dgs({"train", "-s", path("scene"), "-m", path("model"), "--iterations", "2", "--quiet"}).exit_code,
            0);
  const std::string ply = path("model/point_cloud/iteration_2/point_cloud.ply"), cameras = path("model/cameras.json");
  const std::vector<std::string> view{"--view", "00001.png"};
  const auto lists_of = [&](std::vector<std::string> words, bool second) {
    if (second) words.insert(words.end(), view.begin(), view.end());
    return bench(std::move(words))["lists"];
  };
  const json first = lists_of({path("model")}, false), second = lists_of({"kernels", path("model")}, true);
  EXPECT_NE(first, second);
  EXPECT_EQ(second, lists_of({path("scene"), "--ply", ply}, true));
  EXPECT_EQ(second, lists_of({"--ply", ply, "--cameras", cameras}, true));

  const Outcome no_camera = run_b3dgs({"bench", "--ply", ply});
  EXPECT_EQ(no_camera.exit_code, 2);
  EXPECT_NE(no_camera.err.find("--cameras"), std::string::npos) << no_camera.err;
  const Outcome no_view = run_b3dgs({"bench", path("model"), "--view", "none.png"});
  EXPECT_EQ(no_view.exit_code, 2);
  EXPECT_NE(no_view.err.find("none.png"), std::string::npos) << no_view.err;
}

}  // namespace
}  // namespace b3dgs
