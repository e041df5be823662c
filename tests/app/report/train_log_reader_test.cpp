#include "app/report/train_log_reader.h"

#include <gtest/gtest.h>

#include <sstream>

namespace b3dgs {
namespace {

using Json = nlohmann::ordered_json;

TrainHistory parse(const std::string& lines) {
  std::istringstream stream(lines);
  return parse_train_log(stream);
}

TEST(TrainLogReader, ReadsAllFieldsOfALine) {
  const TrainHistory history = parse(
      R"({"iteration":10,"loss":0.5,"ms":20,"count":100,"elapsed_s":0.25,"gpu_peak_bytes":2000000000,"kernel":"combined",)"
      R"("stages_ms":{"bin":1.5,"loss":2},"test_psnr":21.5,"test_ssim":0.7})"
      "\n");
  ASSERT_EQ(history.points.size(), 1u);
  const LogPoint& point = history.points[0];
  EXPECT_EQ(point.iteration, 10);
  EXPECT_EQ(point.loss, 0.5);
  EXPECT_EQ(point.ms, 20);
  EXPECT_EQ(point.count, 100);
  EXPECT_EQ(point.gpu_peak_bytes, 2000000000);
  EXPECT_EQ(point.elapsed_s, 0.25);
  EXPECT_EQ(point.kernel, "combined");
  EXPECT_EQ(point.stages_ms, Json({{"bin", 1.5}, {"loss", 2}}));
  EXPECT_EQ(point.test_psnr, 21.5);
  EXPECT_EQ(point.test_ssim, 0.7);
}

TEST(TrainLogReader, SeparatesEventsFromPoints) {
  const TrainHistory history = parse(
      R"({"iteration":1009,"event":"kernel_check","views":8,"times_ms":{"combined":2,"shared-memory":1.5,"naive":"?"},)"
      R"("error_ms":0.125,"cost_ms":12.5,"before":"combined","after":"shared-memory","reason":"r"})"
      "\n"
      R"({"iteration":1000,"event":"resumed","kernel":"naive","changed_options":["kernel: published -> naive",7]})"
      "\n"
      R"({"iteration":1000,"event":"load_statistics","views":4,"tile_lists":{"min":1,"median":5,"p90":8,"p99":9,"max":10,)"
      R"("mean":5.5,"gini":0.25,"log2_bins":[0,1,2]}})"
      "\n"
      R"({"iteration":1000,"event":"capped","reason":"GPU memory","count":2912344,"limit_bytes":4000000000})"
      "\n"
      R"({"iteration":1000,"event":"of a later version"})"
      "\n");
  EXPECT_TRUE(history.points.empty());
  ASSERT_EQ(history.events["kernel_check"].size(), 1u);
  const Json& check = history.events["kernel_check"][0];
  EXPECT_EQ(check["iteration"], 1009);
  EXPECT_EQ(check["times_ms"], Json({{"combined", 2}, {"shared-memory", 1.5}})) << "what is not a number is ignored";
  EXPECT_EQ(check["error_ms"], 0.125);
  EXPECT_EQ(check["views"], 8);
  EXPECT_EQ(check["before"], "combined");
  EXPECT_EQ(check["after"], "shared-memory");
  EXPECT_EQ(check["reason"], "r");
  EXPECT_EQ(check["cost_ms"], 12.5);
  EXPECT_TRUE(switches_kernel(check));
  EXPECT_EQ(history.events["resumed"][0]["kernel"], "naive");
  EXPECT_EQ(history.events["resumed"][0]["changed_options"], Json::array({"kernel: published -> naive"}))
      << "what is not a text is ignored";
  ASSERT_EQ(history.events["capped"].size(), 1u);
  EXPECT_EQ(history.events["capped"][0], Json({{"iteration", 1000}, {"count", 2912344}, {"reason", "GPU memory"}}));
  ASSERT_EQ(history.events["load_statistics"].size(), 1u);
  const Json& load = history.events["load_statistics"][0];
  EXPECT_EQ(load["views"], 4);
  EXPECT_EQ(load["tile_lists"]["p99"], 9);
  EXPECT_EQ(load["tile_lists"]["gini"], 0.25);
  EXPECT_EQ(load["tile_lists"]["log2_bins"], Json::array({0, 1, 2}));
  EXPECT_TRUE(load["pixel_processed"].is_null());
}

TEST(TrainLogReader, SkipsMissingFieldsAndDamagedLines) {
  const TrainHistory history = parse(R"(no json
{"loss":1}
{"iteration":"ten"}
[1,2]
{"iteration":10,"loss":null,"count":"many","stages_ms":[1],"kernel":7}
{"iteration":5,"loss":1}
{"iteration":20,"event":"kernel_check"}
{"iteration":20,"event":"load_statistics","view":"a.png","tile_lists":3}
{"iteration":20,"lo)");
  ASSERT_EQ(history.points.size(), 1u) << "lines whose iteration does not increase are ignored";
  EXPECT_FALSE(history.points[0].loss);
  EXPECT_FALSE(history.points[0].count);
  EXPECT_TRUE(history.points[0].stages_ms.empty());
  EXPECT_EQ(history.points[0].kernel, "");
  EXPECT_EQ(history.points[0].elapsed_s, 0);
  ASSERT_EQ(history.events["kernel_check"].size(), 1u);
  EXPECT_EQ(history.events["kernel_check"][0]["times_ms"], Json::object());
  EXPECT_EQ(history.events["kernel_check"][0]["reason"], "");
  for (const char* unknown : {"views", "error_ms", "cost_ms"}) {
    EXPECT_TRUE(history.events["kernel_check"][0][unknown].is_null()) << unknown;
  }
  EXPECT_FALSE(switches_kernel(history.events["kernel_check"][0]));
  ASSERT_EQ(history.events["load_statistics"].size(), 1u);
  EXPECT_TRUE(history.events["load_statistics"][0]["tile_lists"].is_null());
  EXPECT_TRUE(history.events["load_statistics"][0]["views"].is_null());
  EXPECT_TRUE(read_train_log("/nonexistent/train.jsonl").points.empty());
}

TEST(TrainLogReader, IgnoresNumbersOutOfRange) {
  const TrainHistory history = parse(R"({"iteration":4294967297,"loss":1}
{"iteration":-3,"loss":1}
{"iteration":10,"loss":1,"count":1e300}
{"iteration":20,"event":"capped","count":1e300})");
  ASSERT_EQ(history.points.size(), 1u);
  EXPECT_EQ(history.points[0].iteration, 10);
  EXPECT_FALSE(history.points[0].count);
  EXPECT_EQ(history.events["capped"][0]["count"], 0);
}

}  // namespace
}  // namespace b3dgs
