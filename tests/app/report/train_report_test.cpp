// The data of the report of one training, from a model folder.
#include "app/report/train_report.h"

#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>

#include "app/report/page_data.h"
#include "config/train_options.h"
#include "scene/images/image.h"
#include "support/files.h"
#include "support/page_data.h"
#include "support/temp_dir.h"

namespace b3dgs {
namespace {

using Json = nlohmann::ordered_json;

class TrainReport : public ::testing::Test {
 protected:
  TrainReport() : folder_(temp_.path()) {
    config_.source_path = "/scenes/garden";
    config_.iterations = 60;
  }

  /// Writes log lines every 10 iterations up to `until`, and returns the data of the report.
  Json data(int until, bool is_evaluated) const {
    std::ofstream(temp_.path() / "config.json") << config_to_json(config_);
    std::ofstream log(folder_.log());
    for (int iteration = 10; iteration <= until; iteration += 10) {
      nlohmann::json line{{"iteration", iteration},         {"loss", 1.0 / iteration},
                          {"elapsed_s", 12.05 * iteration}, {"count", 1000 + iteration},
                          {"gpu_peak_bytes", 2500000000},   {"stages_ms", {{"blend_forward", 3}, {"host", 1}}}};
      if (is_evaluated && iteration % 30 == 0) line["test_psnr"] = 20 + 0.1 * iteration;
      log << line << "\n";
    }
    log.close();
    return train_report_data(folder_);
  }

  void write_previews(bool held_out) const {
    RunInfo info;
    info.held_out = held_out;
    info.iteration = 60;
    info.machine = {{"cpu", "a CPU"}};
    for (const char* name : {"truth_00000.png", "render_00000.png"}) {
      write_image(report_folder(folder_) / name, Image8(8, 6, 3));
    }
    info.previews = {
        {"a.png", 24.5, report_folder(folder_) / "truth_00000.png", report_folder(folder_) / "render_00000.png"}};
    write_run_info(info, folder_);
  }

  test::TempDir temp_;
  ModelFolder folder_;
  TrainConfig config_;
};

TrainHistory history_of(const std::vector<std::optional<double>>& test_psnr) {
  TrainHistory history;
  for (const auto& psnr : test_psnr) {
    LogPoint point;
    point.iteration = 10 * (static_cast<int>(history.points.size()) + 1);
    point.test_psnr = psnr;
    history.points.push_back(point);
  }
  return history;
}

TEST(FindOverfitting, ComparesTheLastEvaluationWithTheBest) {
  EXPECT_FALSE(find_overfitting(history_of({})));
  EXPECT_FALSE(find_overfitting(history_of({std::nullopt, std::nullopt})));
  EXPECT_FALSE(find_overfitting(history_of({20.0})));
  EXPECT_FALSE(find_overfitting(history_of({20.0, 21.0, std::nullopt})));
  EXPECT_FALSE(find_overfitting(history_of({20.0, 21.0, 20.75, 20.875}))) << "not clearly";
  EXPECT_FALSE(find_overfitting(history_of({std::nan(""), 20.0})));
  const auto found = find_overfitting(history_of({20.0, 21.5, std::nullopt, 21.0, 20.75, std::nullopt}));
  ASSERT_TRUE(found);
  EXPECT_EQ(found->iteration, 20);
  EXPECT_EQ(found->lost, 0.75);
}

TEST_F(TrainReport, HasWhatTheHeadlineSays) {
  write_previews(true);
  const Json report = data(60, true);
  EXPECT_EQ(report["kind"], "training");
  EXPECT_EQ(report["scene"], "garden");
  EXPECT_EQ(report["iterations"], 60);
  EXPECT_EQ(report["held_out"], true);
  const Json& curves = report["runs"][0]["curves"];
  EXPECT_EQ(curves["iteration"].back(), 60);
  EXPECT_EQ(curves["elapsed_s"].back(), 723.0);
  EXPECT_EQ(curves["test_psnr"].back(), 26.0);
  EXPECT_EQ(curves["count"].back(), 1060);
  EXPECT_EQ(report["previews"][0]["renders"][0]["psnr"], 24.5);
  EXPECT_EQ(report["gpu_peak_bytes"], 2500000000);
}

TEST_F(TrainReport, OfATrainingWithoutLogOrPreviewsHasEmptyLists) {
  const Json report = data(0, false);
  EXPECT_EQ(report["runs"][0]["curves"]["iteration"], Json::array());
  EXPECT_EQ(report["previews"], Json::array());
  for (const char* unknown : {"overfitting", "limit"}) EXPECT_TRUE(report[unknown].is_null()) << unknown;
}

TEST_F(TrainReport, SaysThatTestViewsWereBetterBefore) {
  EXPECT_TRUE(data(60, true)["overfitting"].is_null());
  std::ofstream(folder_.log(), std::ios::app) << R"({"iteration": 70, "test_psnr": 25.5})";
  EXPECT_EQ(train_report_data(folder_)["overfitting"], Json({{"iteration", 60}, {"lost", 0.5}}));
}

TEST_F(TrainReport, SaysWhatLimitedTheNumberOfGaussians) {
  EXPECT_TRUE(data(60, true)["limit"].is_null());
  std::ofstream(folder_.log(), std::ios::app)
      << R"({"iteration": 60, "event": "capped", "reason": "GPU memory", "count": 1060})";
  EXPECT_EQ(train_report_data(folder_)["limit"], Json({{"iteration", 60}, {"count", 1060}, {"reason", "GPU memory"}}));
}

TEST_F(TrainReport, SaysHowManyGaussiansMayBeFloaters) {
  EXPECT_EQ(data(60, true)["floaters"], "");
  std::ofstream(folder_.log(), std::ios::app)
      << R"({"iteration": 60, "event": "floaters", "unseen": 1234, "one_view": 5, "close": 6, "large": 7})"
      << "\n";
  EXPECT_EQ(train_report_data(folder_)["floaters"],
            "1,234 in no training view, 5 in one only, 6 close to a camera, 7 large in an image");
  std::ofstream(folder_.log(), std::ios::app) << R"({"iteration": 70, "loss": 0.1})"
                                              << "\n";
  EXPECT_EQ(train_report_data(folder_)["floaters"], "") << "of a training that has been continued since";
}

TEST(LimitText, SaysWhetherThereWereSoManyOnce) {
  TrainHistory history;
  EXPECT_EQ(limit_text(history, 1000), "") << "no counts";
  for (const auto& [iteration, count] : {std::pair{10, 400}, {2000, 990}, {2010, 700}}) {
    history.points.emplace_back();
    history.points.back().iteration = iteration;
    history.points.back().count = count;
  }
  EXPECT_EQ(limit_text(history, 0), "");
  EXPECT_EQ(limit_text(history, 730), "growth ended at the limit of 730; a higher --max_gaussians allows more");
  EXPECT_EQ(limit_text(history, 1000), "of 990 after iteration 2,000, those that hardly contribute were removed");
  EXPECT_EQ(limit_text(history, 2000), "the limit of 2,000 was not reached: at most 990 after iteration 2,000");
  history.points[1].test_psnr = 20;
  history.points[1].test_sharpness = 0.654;
  EXPECT_EQ(limit_text(history, 700),
            "growth ended at the limit of 700, and the test views are rendered with 0.65 of the sharpness of their "
            "photographs; a higher --max_gaussians allows more");
  history.points[1].test_sharpness = 0.93;
  EXPECT_EQ(limit_text(history, 700), "growth ended at the limit of 700; a higher --max_gaussians allows more");
}

TEST_F(TrainReport, NamesSceneOptionsAndMachine) {
  write_previews(true);
  const Json report = data(60, true);
  EXPECT_EQ(report["settings"][0], Json::array({"source scene", "garden"}));
  EXPECT_EQ(report["settings"][1],
            Json::array({"options", "iterations 60; otherwise those of --preset inria, --strategy default"}));
  EXPECT_EQ(report["machine"], Json({{"cpu", "a CPU"}}));
}

TEST_F(TrainReport, NamesFilesWithoutWhereTheyAre) {
  config_.source_path = "/home/ann/scenes/garden/";
  config_.model_path = "/home/ann/models/garden";
  config_.masks = "/home/ann/masks";
  config_.init_ply = "../ann/start.ply";
  write_previews(true);
  data(60, true);
  std::ofstream(folder_.log(), std::ios::app)
      << R"({"iteration": 70, "event": "resumed", "kernel": "tile", "changed_options": )"
      << R"(["masks: \"\" -> \"/home/ann/masks\"", "iterations: 50 -> 60"]})"
      << "\n";
  const Json report = train_report_data(folder_);
  EXPECT_EQ(report.dump().find("ann"), std::string::npos) << report.dump();
  EXPECT_EQ(report["settings"][0], Json::array({"source scene", "garden"}));
  EXPECT_EQ(report["settings"][1][1],
            "init_ply start.ply, masks masks, iterations 60; otherwise those of --preset inria, --strategy default");
  EXPECT_EQ(report["runs"][0]["resumes"][0]["changed_options"],
            Json::array({"masks: \"\" -> \"masks\"", "iterations: 50 -> 60"}));
}

TEST_F(TrainReport, IsWrittenAsOnePage) {
  write_previews(true);
  const Json expected = data(60, true);
  const std::filesystem::path path = write_train_report(folder_);
  EXPECT_EQ(path, folder_.root() / "report.html");
  const Json shown = test::data_of_page(test::read_bytes(path));
  for (const char* part : {"scene", "settings", "previews", "machine"}) EXPECT_EQ(shown[part], expected[part]) << part;
}

}  // namespace
}  // namespace b3dgs
