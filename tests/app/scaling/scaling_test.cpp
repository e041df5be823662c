// b3dgs bench scaling: the formulas, and the command.
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "app/tools/commands.h"
#include "app/tools/scaling_model.h"
#include "core/check.h"
#include "support/files.h"
#include "support/temp_dir.h"

namespace b3dgs {
namespace {

using Json = nlohmann::ordered_json;

// Gaussians, splats, pixels of a view; ms to project, draw, compare, optimize and sum.
const SceneCost kScene{"scene", 1000, 800, 500, 2, 10, 1, 4, 6};
// Links, ms for a record and overheads, ns to pack a splat, work of the busiest rank.
const ClusterCost kCluster{{0.1, 1000}, {0.5, 100}, 0.05, 0.3, 0.7, 1000, 1.2};

TEST(ScalingModel, OneGpuExchangesNothing) {
  const Prediction p = predict(kScene, kCluster, 1, 8, 1);
  EXPECT_DOUBLE_EQ(p.step_ms(), 2 + 10 + 1 + 4);
  EXPECT_DOUBLE_EQ(p.speedup, 1);
  EXPECT_DOUBLE_EQ(p.model_bytes, 708000);
  EXPECT_DOUBLE_EQ(predict(kScene, kCluster, 1, 8, 3).step_ms(), 3 * (2 + 10 + 1) + 4 + 6);
}

TEST(ScalingModel, AddsWorkExchangeAndOverhead) {
  const Prediction p = predict(kScene, kCluster, 2, 8, 2);
  EXPECT_DOUBLE_EQ(p.work_ms, 2 + 10 * 1.2 + 1 + (4 + 6) / 2.0);
  // 400 splats of the view that the other one draws, 60 and 48 bytes each, at 1000 bytes per ms.
  EXPECT_DOUBLE_EQ(p.exchange_ms, 0.05 + 2 * 0.1 + 400 * 60 / 1000.0 + 400 * 48 / 1000.0);
  EXPECT_DOUBLE_EQ(p.exchange_bytes, 400 * 108);
  EXPECT_DOUBLE_EQ(p.overhead_ms, 0.3 + 800 * 1e-3);
  EXPECT_DOUBLE_EQ(p.speedup, (2 * (2 + 10 + 1) + 4 + 6) / p.step_ms()) << "against steps of two views";
  EXPECT_DOUBLE_EQ(p.views_per_s(), 2000 / p.step_ms());
  EXPECT_DOUBLE_EQ(p.model_bytes, 354000);
  EXPECT_EQ(p.n_hosts, 1);
}

TEST(ScalingModel, DividesAViewIntoBands) {
  const Prediction p = predict(kScene, kCluster, 4, 8, 1);
  EXPECT_DOUBLE_EQ(p.work_ms, (2 + 10 * 1.2) / 4 + 1 + 4 / 4.0) << "each compares the whole view";
  // Each has 200 of the 800 splats and sends 150; it sends its 125 pixels to three others.
  const double rows = 125 * 12 * 3;
  EXPECT_NEAR(p.exchange_ms, 0.05 + 3 * 0.1 + (150 * 60 + 150 * 48 + rows) / 1000, 1e-12);
  EXPECT_DOUBLE_EQ(p.exchange_bytes, 150 * 108 + rows);
  EXPECT_DOUBLE_EQ(p.overhead_ms, 0.3 + 0.7 + 200 * 1e-3);
  EXPECT_DOUBLE_EQ(p.speedup, 17 / p.step_ms());
}

TEST(ScalingModel, DrawsSeveralViewsOnAGpu) {
  const Prediction p = predict(kScene, kCluster, 2, 8, 4);
  EXPECT_DOUBLE_EQ(p.work_ms, 2 * (2 + 10 * 1.2 + 1) + (4 + 6) / 2.0);
  EXPECT_DOUBLE_EQ(p.exchange_bytes, 2 * 400 * 108);
}

TEST(ScalingModel, GpusOfAHostShareItsNetwork) {
  const Prediction p = predict(kScene, kCluster, 4, 2, 4);
  EXPECT_EQ(p.n_hosts, 2);
  // Each sends 600 splats, two thirds of them to the other host, together with the other GPU of its own.
  const double between = 0.5 + 600 * 60 * 2 / 3.0 * 2 / 100, back = 0.5 + 600 * 48 * 2 / 3.0 * 2 / 100;
  EXPECT_NEAR(p.exchange_ms, 0.05 + 0.5 + between + back, 1e-9);
}

TEST(ScalingModel, StandardScenesAreMeasuredOrScaled) {
  const std::vector<SceneCost> scenes = standard_scenes();
  ASSERT_EQ(scenes.size(), 2u);
  EXPECT_NEAR(scenes[0].alone_ms(1), 1.29, 0.01) << "docs/benchmarks.md";
  EXPECT_GT(scenes[1].alone_ms(1), 10 * scenes[0].alone_ms(1));
}

Json exchange_file() {
  return {{"rows",
           {{{"exchange", "record"}, {"received_bytes", 0}, {"median_ms", 0.03}},
            {{"exchange", "all-to-all"}, {"received_bytes", 1000}, {"median_ms", 0.14}},
            {{"exchange", "all-to-all"}, {"received_bytes", 5000}, {"median_ms", 0.3}},
            {{"exchange", "all-gather"}, {"received_bytes", 5000}, {"median_ms", 9}}}}};
}

TEST(ScalingModel, FitsALineToMeasuredExchanges) {
  ClusterCost cluster = kCluster;
  read_exchange(exchange_file(), "file", cluster);
  EXPECT_NEAR(cluster.in_host.bytes_per_ms, 25000, 1e-6);
  EXPECT_NEAR(cluster.in_host.latency_ms, 0.1, 1e-9);
  EXPECT_EQ(cluster.record_ms, 0.03);
  EXPECT_EQ(cluster.network.bytes_per_ms, 100) << "not in the file";
}

void expect_refused(const Json& file, const std::string& part) {
  ClusterCost cluster;
  try {
    read_exchange(file, "exchange.json", cluster);
    ADD_FAILURE() << "accepted: " << file;
  } catch (const InputError& error) {
    EXPECT_EQ(std::string(error.what()).rfind("exchange.json: ", 0), 0u) << error.what();
    EXPECT_NE(std::string(error.what()).find(part), std::string::npos) << error.what();
  }
}

TEST(ScalingModel, RefusesFilesWithoutExchanges) {
  expect_refused(Json::array(), "no rows");
  expect_refused({{"rows", 3}}, "no rows");
  expect_refused({{"rows", {1, "x"}}}, "no time of a record");
  Json file = exchange_file();
  file["rows"][2]["median_ms"] = "fast";
  expect_refused(file, "at least two sizes");
  file = exchange_file();
  file["rows"][2]["received_bytes"] = 1000;
  expect_refused(file, "at least two sizes");
  file = exchange_file();
  file["rows"][2]["median_ms"] = 0.1;
  expect_refused(file, "do not take longer");
  file = exchange_file();
  file["rows"][0]["exchange"] = Json::array();
  expect_refused(file, "no time of a record");
}

TEST(BenchScaling, PrintsPredictions) {
  const test::TempDir temp;
  const std::string exchange = (temp / "exchange.json").string(), out = (temp / "out.json").string();
  test::write_bytes(exchange, exchange_file().dump());
  testing::internal::CaptureStdout();
  EXPECT_EQ(run_bench_scaling({"--gpus", "1", "4", "--exchange", exchange, "--json", out}), 0);
  const std::string text = testing::internal::GetCapturedStdout();
  std::size_t n_lines = 0;
  for (std::size_t at = 0; (at = text.find("prediction\n", at)) != std::string::npos; ++at) ++n_lines;
  EXPECT_EQ(n_lines, 4u) << text;
  const Json rows = Json::parse(test::read_bytes(out))["rows"];
  ASSERT_EQ(rows.size(), 4u);
  EXPECT_EQ(rows[1]["gpus"], 4);
  EXPECT_EQ(rows[1]["prediction"], true);
}

TEST(BenchScaling, RefusesBadInput) {
  const test::TempDir temp;
  EXPECT_THROW(run_bench_scaling({"--exchange", (temp / "none.json").string()}), InputError);
  test::write_bytes(temp / "bad.json", "{");
  EXPECT_THROW(run_bench_scaling({"--exchange", (temp / "bad.json").string()}), InputError);
  EXPECT_THROW(run_bench_scaling({"--gpus", "0"}), InputError);
  EXPECT_THROW(run_bench_scaling({"--gpus", "8", "--batch", "3"}), InputError);
  EXPECT_THROW(run_bench_scaling({"--gpus", "2", "4", "--batch", "6"}), InputError);
}

}  // namespace
}  // namespace b3dgs
