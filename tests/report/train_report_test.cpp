// report.html of one training, written from a model folder.
#include "report/train_report.h"

#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>

#include "report/run_info.h"
#include "scene/images/image_io.h"
#include "support/files.h"
#include "support/temp_dir.h"
#include "support/xml.h"

namespace b3dgs {
namespace {

class TrainReport : public ::testing::Test {
 protected:
  TrainReport() : folder_(temp_.path()) {
    config_.source_path = "/scenes/garden";
    config_.iterations = 60;
  }

  /// Log lines every 10 iterations up to `until`.
  std::string page(int until, bool is_evaluated) const {
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
    return test::read_bytes(write_train_report(folder_));
  }

  void write_previews(bool held_out) const {
    RunInfo info;
    info.held_out = held_out;
    info.iteration = 60;
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
  EXPECT_EQ(found->psnr, 21.5);
  EXPECT_EQ(found->lost, 0.75);
}

bool contains(const std::string& page, const std::string& text) {
  return page.find(text) != std::string::npos;
}

TEST_F(TrainReport, HeadlineHasTimeQualityAndSize) {
  write_previews(true);
  const std::string html = page(60, true);
  EXPECT_EQ(test::xml_fault(html), "");
  EXPECT_TRUE(contains(html, "<h1>garden: trained in 12 min 3 s, PSNR 26.00 dB on test views, 1,060 Gaussians</h1>"))
      << html.substr(html.find("<h1>"), 200);
}

TEST_F(TrainReport, HeadlineOfATrainingWithoutTestViewsSaysSo) {
  write_previews(false);
  EXPECT_TRUE(contains(page(60, false), "PSNR 24.50 dB on 1 training view, 1,060 Gaussians</h1>"));
}

TEST_F(TrainReport, HeadlineOfAnUnfinishedTrainingSaysHowFarItIs) {
  EXPECT_TRUE(contains(page(40, true),
                       "<h1>garden: not finished, 40 of 60 iterations in 8 min 2 s, PSNR 23.00 dB on "
                       "test views at iteration 30, 1,040 Gaussians</h1>"));
  EXPECT_TRUE(contains(page(0, false), "<h1>garden: no iterations logged yet</h1>"));
}

TEST_F(TrainReport, SaysThatTestViewsWereBetterBefore) {
  EXPECT_FALSE(contains(page(60, true), "Overfitting"));
  std::ofstream(folder_.log(), std::ios::app) << R"({"iteration": 70, "test_psnr": 25.5})";
  EXPECT_TRUE(contains(test::read_bytes(write_train_report(folder_)),
                       "Overfitting: after iteration 60, PSNR on the test views was 0.50 dB higher"));
}

TEST_F(TrainReport, SaysHowManyGaussiansMayBeFloaters) {
  EXPECT_FALSE(contains(page(60, true), "no training view"));
  std::ofstream(folder_.log(), std::ios::app)
      << R"({"iteration": 60, "event": "floaters", "unseen": 1234, "one_view": 5, "close": 6, "large": 7})"
      << "\n";
  const std::string text = "1,234 in no training view, 5 in one only, 6 close to a camera, 7 large in an image";
  EXPECT_EQ(floaters_text(read_train_log(folder_.log())), text);
  EXPECT_TRUE(contains(test::read_bytes(write_train_report(folder_)), "Gaussians that may be floaters: " + text));

  std::ofstream(folder_.log(), std::ios::app) << R"({"iteration": 70, "loss": 0.1})"
                                              << "\n";
  EXPECT_EQ(floaters_text(read_train_log(folder_.log())), "") << "of a training that has been continued since";
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
  EXPECT_EQ(limit_text(history, 730), "");
  EXPECT_EQ(limit_text(history, 1000), "of 990 after iteration 2,000, those that hardly contribute were removed");
  EXPECT_EQ(limit_text(history, 2000), "the limit of 2,000 was not reached: at most 990 after iteration 2,000");
}

TEST_F(TrainReport, BeginsWithPicturesAndQualityAndFoldsTheRest) {
  write_previews(true);
  const std::string html = page(60, true);
  std::size_t at = 0;
  for (const char* part :
       {"<h2>Photographs and renders", "data:image/jpeg", "<h2>Quality", "PSNR over the iterations",
        "<h2>Time and memory", "GPU memory peaked at 2.50 GB", "mean time, ms", "remaining CPU time",
        "<h2>Scene, options and machine", "/scenes/garden",
        "iterations 60; otherwise those of --preset original, --strategy default", "<details>\n<summary>Load",
        "<details>\n<summary>Kernels", "<details>\n<summary>Words", "Gini coefficient"}) {
    const std::size_t next = html.find(part, at);
    ASSERT_NE(next, std::string::npos) << part << " is missing or in the wrong place";
    at = next;
  }
}

}  // namespace
}  // namespace b3dgs
