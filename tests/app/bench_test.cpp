// Figures of the benchmark: tables, statistics, made-up scenes, and what `b3dgs bench` says from outside.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>

#include "app/bench_report.h"
#include "app/bench_scenes.h"
#include "app/run_program.h"
#include "check.h"
#include "data_synth/synth_scene.h"
#include "support/expect_error.h"
#include "support/files.h"
#include "support/temp_dir.h"
#include "train/evaluate.h"

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
  const auto even = list_statistics(std::vector<std::int64_t>(100, 7));
  EXPECT_EQ(even["mean"], 7);
  EXPECT_EQ(even["max"], 7);
  EXPECT_NEAR(even["gini"].get<double>(), 0, 1e-12);

  std::vector<std::int64_t> one(100, 0);
  one[37] = 1000;
  const auto crowded = list_statistics(one);
  EXPECT_EQ(crowded["median"], 0);
  EXPECT_EQ(crowded["pairs"], 1000);
  EXPECT_NEAR(crowded["gini"].get<double>(), 0.99, 1e-12);  // 1 - 1 / n

  EXPECT_EQ(list_statistics({0, 0, 0})["gini"], 0) << "nothing is evenly spread";
}

TEST(BenchReport, DifferencesSeeValuesThatAreNoNumbers) {
  EXPECT_EQ(largest_difference({1, 2, 3}, {1, 4, 2}), 2);
  EXPECT_EQ(largest_difference({1, std::numeric_limits<float>::quiet_NaN(), 3}, {1, 2, 3}), HUGE_VAL);
  EXPECT_EQ(relative_difference({0.5f, -4}, {1, -4}), 0.125);
  EXPECT_EQ(relative_difference({0, 0}, {0, 0}), 0);
  EXPECT_EQ(relative_difference({0, 1}, {0, 0}), HUGE_VAL);
  EXPECT_THROW(largest_difference({1}, {1, 2}), Error);
}

TEST(BenchReport, ComparesEveryRowWithTheFirst) {
  testing::internal::CaptureStdout();
  ComparisonTable table("forward kernel", {/*image=*/true, /*gradients=*/true, /*resources=*/true});
  table.add({"naive",
             {6, 5, 7},
             {0.5f, 1},
             {{"means", {10, -20}}, {"sh0", {1, 1}}},
             cuda::KernelResources{128, 40, 4096, 0, 1536, 2048}});
  table.add({"fast", {2, 2, 2}, {0.5f, 0.75f}, {{"means", {10, -19}}, {"sh0", {1, 0.9f}}}, cuda::KernelResources{}});
  const std::string printed = testing::internal::GetCapturedStdout();
  const json rows = table.rows();
  ASSERT_EQ(rows.size(), 2u);
  EXPECT_EQ(rows[0]["kernel"], "naive");
  EXPECT_EQ(rows[0]["registers"], 40);
  EXPECT_EQ(rows[0]["shared_bytes"], 4096);
  EXPECT_EQ(rows[0]["occupancy_percent"], 75);
  EXPECT_EQ(rows[0]["image_difference"], 0);
  EXPECT_EQ(rows[0]["gradient_difference"], 0);
  EXPECT_EQ(rows[1]["speedup"], 3);
  EXPECT_EQ(rows[1]["image_difference"], 0.25);
  EXPECT_NEAR(rows[1]["gradient_difference"].get<double>(), 0.1, 1e-6) << "the largest of the parameters";
  EXPECT_EQ(rows[1]["gradient_difference_by_parameter"]["means"], 0.05);
  for (const char* part : {"registers", "75.0 %", "4096", "2.5e-01", "1.0e-01"}) {
    EXPECT_NE(printed.find(part), std::string::npos) << printed;
  }
}

TEST(BenchReport, ColumnsThatWereNotMeasuredAreAbsent) {
  testing::internal::CaptureStdout();
  ComparisonTable table("forward kernel", {});
  table.add({"naive", {1, 1, 1}, {0.5f}, {}});
  EXPECT_EQ(testing::internal::GetCapturedStdout().find("registers"), std::string::npos);
  EXPECT_FALSE(table.rows()[0].contains("gradient_difference"));
  EXPECT_FALSE(table.rows()[0].contains("registers"));
}

TEST(BenchRun, TakesTheTileOfTrainingUnlessToldOtherwise) {
  for (const char* device : {"cpu", "cuda"}) {
    TrainConfig training;
    training.device = device;
    const TileShape expected = tile_shape(training);
    BenchRun open, told;
    open.device = told.device = device;
    told.tile_width = 24;
    told.tile_height = 4;
    take_default_tile(open);
    take_default_tile(told);
    EXPECT_EQ(open.tile_width, expected.width) << device;
    EXPECT_EQ(open.tile_height, expected.height) << device;
    EXPECT_EQ(told.tile_width, 24) << device;
    EXPECT_EQ(told.tile_height, 4) << device;
  }
}

constexpr int kWidth = 480, kHeight = 270;

/// Distances of the seen points from the image's centre, ascending: the larger of |x| and |y|, each in half images.
std::vector<double> distances(const std::vector<float>& positions, double focal) {
  std::vector<double> seen;
  for (std::size_t i = 0; i < positions.size(); i += 3) {
    const double scale = focal / positions[i + 2];
    const double distance =
        std::max(std::abs(scale * positions[i]) / (0.5 * kWidth), std::abs(scale * positions[i + 1]) / (0.5 * kHeight));
    if (distance < 1) seen.push_back(distance);
  }
  std::sort(seen.begin(), seen.end());
  return seen;
}

std::vector<double> spread_distances(double skew) {
  BenchRun run;
  run.width = kWidth;
  run.height = kHeight;
  return distances(make_spread_scene({20000, skew, 0}, run).cloud.means, 1000);
}

/// Largest distance between the two samples' distributions (Kolmogorov-Smirnov).
double distance_of_laws(const std::vector<double>& a, const std::vector<double>& b) {
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
  EXPECT_LT(distance_of_laws(areas, even), 1.63 / std::sqrt(20000.0));  // exceeded once in a hundred seeds
}

TEST(SpreadScene, SkewOfOneFollowsTheLawOfStreet) {
  SynthConfig config;
  config.scene = "street";
  config.points = 30000;
  config.views = 1;
  config.width = kWidth;
  config.height = kHeight;
  const SynthScene street = make_scene(config);
  const std::vector<double> law = distances(street.points.positions, street.cameras.front().fx);
  EXPECT_LT(distance_of_laws(spread_distances(1), law), 0.03);
  EXPECT_GT(distance_of_laws(spread_distances(0.75), law), 0.1);
}

TEST(SpreadScene, SkewMovesGaussiansTowardsTheCentreAndChangesNothingElse) {
  double before = 1;
  for (const double skew : {0.0, 0.5, 0.999999999999, 1.0, 1.5, 2.0}) {
    const std::vector<double> values = spread_distances(skew);
    ASSERT_GT(values.size(), 19990u) << "all are in the image";
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

class BenchProgram : public ::testing::Test {
 protected:
  std::string path(const char* name) const { return (folder_ / name).string(); }

  /// Runs `b3dgs bench WORDS` and returns its JSON.
  json bench(std::vector<std::string> words) const {
    words.insert(words.begin(), "bench");
    words.insert(words.end(), {"--repeat", "1", "--json", path("report.json")});
    const Outcome outcome = run_b3dgs(words);
    EXPECT_EQ(outcome.exit_code, 0) << outcome.err;
    return json::parse(test::read_bytes(path("report.json")));
  }

  test::TempDir folder_;
};

TEST_F(BenchProgram, SweepHasACellForEveryNumberAndSkew) {
  const json report = bench({"sweep", "--points", "300", "900", "--skew", "0", "1", "--width", "96", "--height", "64"});
  ASSERT_EQ(report["cells"].size(), 4u);
  for (const json& cell : report["cells"]) {
    ASSERT_EQ(cell["kernels"].size(), 5u);
    const auto fastest = std::min_element(cell["kernels"].begin(), cell["kernels"].end(),
                                          [](const json& a, const json& b) { return a["median_ms"] < b["median_ms"]; });
    EXPECT_EQ(cell["fastest"], (*fastest)["kernel"]);
  }
  EXPECT_EQ(report["cells"][1]["skew"], 1);
  EXPECT_EQ(report["cells"][3]["points"], 900);
  EXPECT_GT(report["cells"][3]["lists"]["gini"], report["cells"][2]["lists"]["gini"]);
  EXPECT_GT(report["cells"][2]["lists"]["pairs"], report["cells"][0]["lists"]["pairs"]);
  EXPECT_EQ(report["config"]["tile_width"], 16) << "the tile that was used, not the option's default";
  EXPECT_EQ(report["config"]["tile_height"], 16);

  const Outcome empty = run_b3dgs({"bench", "sweep", "--skew"});
  EXPECT_EQ(empty.exit_code, 2);
  EXPECT_NE(empty.err.find("skew needs at least one value"), std::string::npos) << empty.err;
}

TEST_F(BenchProgram, AModelAndAPlyWithItsCamerasShowTheSameView) {
  ASSERT_EQ(run_b3dgs({"synth", "orbit", path("scene"), "--points", "300", "--views", "3", "--width", "48", "--height",
                       "32", "--quiet"})
                .exit_code,
            0);
  ASSERT_EQ(run_b3dgs({"train", "-s", path("scene"), "-m", path("model"), "--iterations", "2", "--quiet"}).exit_code,
            0);
  const std::string ply = path("model/point_cloud/iteration_2/point_cloud.ply"), cameras = path("model/cameras.json");
  const std::vector<std::string> view{"--view", "00001.png"};
  const auto seen = [&](std::vector<std::string> words, bool second) {
    if (second) words.insert(words.end(), view.begin(), view.end());
    return bench(std::move(words))["lists"];
  };
  const json first = seen({path("model")}, false), second = seen({"kernels", path("model")}, true);
  EXPECT_NE(first, second);
  EXPECT_EQ(second, seen({path("scene"), "--ply", ply}, true));
  EXPECT_EQ(second, seen({"--ply", ply, "--cameras", cameras}, true));

  const Outcome no_camera = run_b3dgs({"bench", "--ply", ply});
  EXPECT_EQ(no_camera.exit_code, 2);
  EXPECT_NE(no_camera.err.find("--cameras"), std::string::npos) << no_camera.err;
  const Outcome no_view = run_b3dgs({"bench", path("model"), "--view", "none.png"});
  EXPECT_EQ(no_view.exit_code, 2);
  EXPECT_NE(no_view.err.find("none.png"), std::string::npos) << no_view.err;
}

}  // namespace
}  // namespace b3dgs
