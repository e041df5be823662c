// The data shared by reports of trainings and comparisons, for synthetic histories.
#include "app/report/page_data.h"

#include <gtest/gtest.h>

#include "config/train_options.h"
#include "scene/images/image.h"
#include "support/expect_error.h"
#include "support/files.h"
#include "support/temp_dir.h"

namespace b3dgs {
namespace {

using Json = nlohmann::ordered_json;

TrainHistory eventful_history() {
  TrainHistory history;
  for (int iteration = 10; iteration <= 100; iteration += 10) {
    LogPoint& point = history.points.emplace_back();
    point.iteration = iteration;
    point.elapsed_s = 0.1 * iteration;
    point.kernel = iteration <= 40 ? "combined" : "naive";
    if (iteration > 80) point.stages_ms = {{"bin", iteration}, {"later", 1}};
  }
  history.points.back().test_psnr = 21.5;
  const Json times{{"combined", 1.25}, {"shared-memory", 1.5}};
  history.events["kernel_check"].push_back(
      {{"iteration", 9}, {"times_ms", times}, {"before", "combined"}, {"after", "combined"}});
  history.events["load_statistics"].push_back({{"iteration", 10}, {"views", 4}, {"tile_lists", {{"p99", 2000}}}});
  history.events["resumed"].push_back({{"iteration", 40}, {"changed_options", {"kernel: combined -> naive"}}});
  return history;
}

TEST(HistoryJson, HasAllCurvesChecksAndLoads) {
  const TrainHistory history = eventful_history();
  const Json json = history_json(history);
  EXPECT_EQ(json["curves"]["iteration"].size(), 10u);
  EXPECT_EQ(json["curves"]["kernel"][9], "naive");
  EXPECT_EQ(json["curves"]["test_psnr"][9], 21.5);
  EXPECT_TRUE(json["curves"]["test_psnr"][0].is_null()) << "was not measured";
  EXPECT_EQ(json["stages_ms"], Json({{"bin", 95.0}, {"later", 1.0}})) << "means of the steps that were timed";
  EXPECT_EQ(json["kernel_checks"], history.events["kernel_check"]);
  EXPECT_EQ(json["load_statistics"], history.events["load_statistics"]);
}

TEST(RunData, HasWhatTheSectionOnKernelsNeeds) {
  const Json run = run_data("garden", 7, eventful_history());
  EXPECT_EQ(run["name"], "garden");
  EXPECT_EQ(run["seed"], 7);
  EXPECT_EQ(run["kernel_checks"][0]["times_ms"]["combined"], 1.25);
  EXPECT_EQ(run["load_statistics"][0]["views"], 4);
  ASSERT_EQ(run["kernel_periods"].size(), 2u);
  EXPECT_EQ(run["kernel_periods"][0], Json({{"kernel", "combined"}, {"from", 0}, {"until", 40}}));
  EXPECT_EQ(run["kernel_periods"][1], Json({{"kernel", "naive"}, {"from", 40}, {"until", 100}}));
  EXPECT_EQ(run["resumes"][0]["changed_options"][0], "kernel: combined -> naive");
  EXPECT_FALSE(run["curves"].contains("kernel")) << "the periods say that in fewer bytes";
  const Json empty = run_data("", 0, TrainHistory{});
  for (const char* list : {"kernel_checks", "load_statistics", "kernel_periods", "resumes"}) {
    EXPECT_EQ(empty[list], Json::array()) << list;
  }
}

TEST(PreviewsData, HasEachPhotographWithTheRendersOfAllRuns) {
  const test::TempDir folder;
  write_image(folder.path() / "a.png", Image8(8, 6, 3));
  RunInfo first, second;
  first.previews = {{"view <1>", 24.5, folder.path() / "a.png", folder.path() / "a.png"},
                    {"view 2", 25, folder.path() / "a.png", folder.path() / "deleted.png"}};
  second.previews = {first.previews[0]};
  const Json previews = previews_data({{"x", first}, {"y", second}});
  ASSERT_EQ(previews.size(), 2u);
  EXPECT_EQ(previews[0]["view"], "view <1>");
  EXPECT_EQ(previews[0]["photograph"].get<std::string>().find("data:image/jpeg"), 0u);
  ASSERT_EQ(previews[0]["renders"].size(), 2u);
  EXPECT_EQ(previews[0]["renders"][1]["name"], "y");
  EXPECT_EQ(previews[0]["renders"][1]["psnr"], 24.5);
  ASSERT_EQ(previews[1]["renders"].size(), 1u) << "the second run has only one preview";
  EXPECT_EQ(previews[1]["renders"][0]["image"], "") << "deleted";
}

TEST(ChangedOptions, AreThoseThatDifferFromTheDefaults) {
  const Json defaults = config_to_json(TrainConfig{});
  EXPECT_EQ(changed_options(defaults, defaults), "");
  TrainConfig config;
  config.source_path = "/scenes/garden";
  config.device = "cpu";
  config.eval = true;
  config.test_iterations = {10, 20};
  EXPECT_EQ(changed_options(defaults, config_to_json(config)), "eval on, test_iterations 10 20")
      << "scene and device are shown elsewhere";
}

TEST(RunInfoFile, LeavesOutPicturesOutsideOfTheReportAndDamagedOnes) {
  test::TempDir temp;
  const ModelFolder folder(temp / "model");
  const std::filesystem::path secret = temp / "private.png", report = report_folder(folder);
  write_image(secret, Image8(8, 6, 3));
  write_image(report / "own.png", Image8(8, 6, 3));
  std::filesystem::create_symlink(secret, report / "link.png");
  const auto read_with = [&](const std::string& truth, const std::string& render) {
    const Json preview{{"view", "a"}, {"psnr", 20}, {"truth", truth}, {"render", render}};
    test::write_bytes(report / "run.json", Json{{"previews", Json::array({preview})}}.dump());
    return read_run_info(folder);
  };
  EXPECT_EQ(read_with("own.png", "own.png").previews.at(0).photograph, report / "own.png");
  for (const std::string& name : {secret.string(), std::string("../../private.png"), std::string("link.png")}) {
    for (const bool is_truth : {true, false}) {
      const Preview read = (is_truth ? read_with(name, "own.png") : read_with("own.png", name)).previews.at(0);
      EXPECT_EQ(read.photograph, is_truth ? std::filesystem::path() : report / "own.png") << name;
      EXPECT_EQ(read.render, is_truth ? report / "own.png" : std::filesystem::path()) << name;
      const Json shown = previews_data({{"run", read_run_info(folder)}}).at(0);
      EXPECT_EQ(shown["photograph"] == "", is_truth) << name;
      EXPECT_EQ(shown["renders"][0]["image"] == "", !is_truth) << name;
    }
  }
  test::write_bytes(report / "damaged.png", "no image");
  EXPECT_EQ(previews_data({{"run", read_with("damaged.png", "own.png")}}).at(0)["photograph"], "");
}

}  // namespace
}  // namespace b3dgs
