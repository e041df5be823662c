// The data of a comparison's report, and the text that a browser shows of it, for synthetic runs.
#include "app/compare/comparison.h"

#include <gtest/gtest.h>
#include <sys/wait.h>

#include <algorithm>
#include <cstdlib>
#include <fstream>
#include <initializer_list>
#include <map>

#include "app/compare/compare_verdict.h"
#include "app/compare/synthetic_histories.h"
#include "app/report/page_data.h"
#include "app/report/train_report.h"
#include "config/option_layers.h"
#include "config/train_options.h"
#include "scene/images/image.h"
#include "support/expect_error.h"
#include "support/files.h"
#include "support/temp_dir.h"

namespace b3dgs {
namespace {

using Json = nlohmann::ordered_json;

/// Returns lines every 10 iterations up to 100, of 100 x `ms` each, so that times can be judged. Switches from
/// segmented to sub-tile at `switch_iteration` (0: never).
TrainHistory steady_history(double ms, int switch_iteration = 0) {
  const TrainHistory steady = test::history(100 * ms, 100 * ms, 100);
  return switch_iteration == 0 ? test::with_kernel(steady, "segmented") : test::with_switch(steady, switch_iteration);
}

/// Makes a comparison with two seeds, 3 and 5, of each configuration.
Comparison comparison_of(const std::vector<std::pair<std::string, std::vector<TrainHistory>>>& configurations) {
  Comparison comparison;
  comparison.plan.base.source_path = "/scenes/garden";
  comparison.plan.seeds = {3, 5};
  for (const auto& [name, by_seed] : configurations) {
    comparison.configurations.push_back({name, comparison.plan.base, by_seed});
    TrainConfig& config = comparison.configurations.back().config;
    config.kernel = find_kernel(name) || name == kPublishedKernel ? name : kAdaptive;
    if (name == "naive-kernels" || name == kPublishedKernel) config.culling = Culling::kSquare;
    if (name == "naive-kernels" || name == "naive_again") config.kernel = "naive";
    comparison.infos.emplace_back(by_seed.size());
  }
  comparison.summary = summarize_comparison(comparison.configurations, 100, 10);
  return comparison;
}

TEST(CompareReportData, HasTheRunsOfAllSeedsAndTheSummary) {
  const Json data = comparison_report_data(comparison_of(
      {{"naive", {steady_history(10), steady_history(10)}}, {"adaptive", {steady_history(8, 51), steady_history(8)}}}));
  EXPECT_EQ(data["kind"], "comparison");
  EXPECT_EQ(data["scene"], "garden");
  EXPECT_EQ(data["seeds"], Json::array({3, 5}));
  ASSERT_EQ(data["runs"].size(), 4u);
  EXPECT_EQ(data["runs"][2]["name"], "adaptive");
  EXPECT_EQ(data["runs"][2]["seed"], 3);
  EXPECT_EQ(data["runs"][2]["kernel_checks"][0]["after"], "sub-tile");
  EXPECT_EQ(data["summary"]["compared"][0]["inflection"]["n"], 1) << "of two seeds";
  EXPECT_EQ(data["summary"]["compared"][0]["inflection"]["mean"], 51);
  EXPECT_EQ(data["tables"]["results"][2][0], "adaptive");
  EXPECT_TRUE(data["tables"]["balancing"].empty()) << "without sub-tile";
  EXPECT_EQ(data["summary"]["repetition"], "") << "the run-to-run variation was not measured";
  EXPECT_EQ(data["options"], Json::array({Json::array({"kernel", "naive", "adaptive"})}));
}

TEST(CompareReportData, NamesOptionsOfAllOnlyWhereTheyAre) {
  Comparison comparison = comparison_of(
      {{"naive", {steady_history(10), steady_history(10)}}, {"mine", {steady_history(8), steady_history(8)}}});
  comparison.plan.base.gaussians_per_pixel = 1.5;  // of the default preset, which both configurations override
  comparison.plan.base.lambda_dssim = 0.3;
  for (ConfigurationHistory& own : comparison.configurations) {
    own.config.gaussians_per_pixel = 2.5;
    own.config.kernel = "naive";
  }
  comparison.plan.base.source_path = "/home/ann/garden";
  comparison.configurations[0].config.masks = "/home/ann/masks";
  comparison.configurations[0].config.lambda_dssim = 0.1;
  comparison.configurations[1].config.lambda_dssim = 0.4;
  const Json data = comparison_report_data(comparison);
  const std::string all = data["settings"].dump();
  EXPECT_TRUE(test::contains(all, "gaussians_per_pixel 2.5")) << all;
  EXPECT_FALSE(test::contains(all, "lambda_dssim")) << all;
  EXPECT_FALSE(test::contains(data.dump(), "gaussians_per_pixel 1.5"));
  EXPECT_EQ(data["options"],
            Json::array({Json::array({"masks", "masks", "none"}), Json::array({"lambda_dssim", "0.1", "0.4"})}));
  EXPECT_EQ(data["settings"][0], Json::array({"source scene", "garden"}));
  EXPECT_FALSE(test::contains(data.dump(), "/home")) << "where files are";
}

TEST(CompareReportData, NamesOptionsOfAllOnlyWhereTheyDifferFromThePreset) {
  Comparison comparison = comparison_of({{"naive", {steady_history(10)}}, {"mine", {steady_history(8)}}});
  for (ConfigurationHistory& own : comparison.configurations) {
    const std::string kernel = own.config.kernel;
    own.config = resolve_options({{"preset", "fast"}, {"iterations", 200}, {"lambda_dssim", 0.3}}).config;
    own.config.kernel = kernel;
  }
  const Json settings = comparison_report_data(comparison)["settings"];
  EXPECT_EQ(settings.back(), Json::array({"options of all",
                                          "iterations 200, lambda_dssim 0.3; otherwise, but for the table below, as "
                                          "in --preset fast"}));
}

TEST(CompareReport, TheTableOnTheTerminalSaysWhatIsMoreThanChance) {
  const std::string several = describe_comparison(comparison_of(
      {{"naive", {steady_history(10), steady_history(10)}}, {"combined", {steady_history(8), steady_history(8)}}}));
  EXPECT_TRUE(test::contains(several, "20.0 %  20.0 to 20.0 %  faster\n")) << several;
  const std::string one =
      describe_comparison(comparison_of({{"naive", {steady_history(10)}}, {"combined", {steady_history(9.5)}}}));
  EXPECT_TRUE(test::contains(one, "5.0 %            10 %  unclear\n")) << one;
  EXPECT_TRUE(test::contains(one, "\none-seed limit: smaller differences may be chance, if times ")) << one;
  EXPECT_TRUE(test::contains(one, "\ntime saved: share of naive's training time\n")) << one;
}

TEST(CompareReport, TheTableOnTheTerminalHasNoEmptyColumns) {
  Comparison one = comparison_of({{"naive", {steady_history(10)}}, {"combined", {steady_history(8)}}});
  const std::string text = describe_comparison(one);
  EXPECT_EQ(text.substr(0, text.find('\n')),
            "configuration  iterations  training s  time saved  one-seed limit    time");
  one.configurations[1].config.iterations /= 2;
  one.summary = summarize_comparison(one.configurations, 100, 10);
  EXPECT_FALSE(test::contains(describe_comparison(one), "time saved")) << describe_comparison(one);
}

TEST(CompareReport, TheTableOnTheTerminalShowsTrainingsThatAreNotComplete) {
  TrainHistory naive = steady_history(10), ours = steady_history(8);
  for (TrainHistory* own : {&naive, &ours}) {
    own->points.back().test_psnr = own == &naive ? 25 : 23;
    own->points.back().test_ssim = 0.75;
    own->points.back().count = 1234;
  }
  // No training is complete, and for the second seed only naive has begun.
  const std::string text =
      describe_comparison(comparison_of({{"naive", {naive, naive}}, {"combined", {ours, TrainHistory{}}}}));
  EXPECT_EQ(text.substr(0, text.find("time saved:")),
            "configuration  iterations  training s  time saved  one-seed limit    time  PSNR dB  difference  one-seed "
            "limit     PSNR    SSIM  Gaussians\n"
            "naive              30,000      100.00           -               -       -    25.00           -           "
            "    -        -  0.7500      1,234\n"
            "combined           30,000       80.00      20.0 %            10 %  faster    23.00    -2.00 dB           "
            " 1 dB  differs  0.7500      1,234\n");
}

class ReportInBrowser : public ::testing::Test {
 protected:
  /// Returns the text that a browser shows of a page, or "" if none is installed. Words of a table's cells are
  /// separated by tabs.
  std::string shown(const std::filesystem::path& report) const {
    const std::string command = std::string(B3DGS_SOURCE) + "/scripts/check_report.sh " + report.string() + " " +
                                (folder_.path() / "pictures").string() + " 2>&1";
    const int status = std::system(command.c_str());
    if (WEXITSTATUS(status) == 77) return "";
    EXPECT_EQ(WEXITSTATUS(status), 0) << command;
    return test::read_bytes(folder_.path() / "pictures/text.txt");
  }

  std::string shown(const Comparison& comparison) const {
    const std::filesystem::path path = folder_.path() / "report.html";
    std::ofstream(path) << report_page(comparison_report_data(comparison));
    return shown(path);
  }

  test::TempDir folder_;
};

void expect_in_order(const std::string& text, std::initializer_list<const char*> parts) {
  std::size_t at = 0;
  for (const char* part : parts) {
    const std::size_t next = text.find(part, at);
    ASSERT_NE(next, std::string::npos) << part << " is missing or in the wrong place: " << text;
    at = next;
  }
}

TEST_F(ReportInBrowser, ShowsTheHeadlineAndTheTablesOfTheTerminal) {
  TrainHistory naive = steady_history(10), again = steady_history(10.2), shared = steady_history(5),
               ours = steady_history(4, 51);
  for (TrainHistory* own : {&naive, &again, &shared, &ours}) own->points.back().test_psnr = 25;
  again.points.back().test_psnr = 25.25;
  const Comparison comparison = comparison_of({{"naive", {naive, naive}},
                                               {"sub-tile", {shared, shared}},
                                               {"mine", {ours, ours}},
                                               {"naive_again", {again, again}}});
  const std::string text = shown(comparison);
  if (text.empty()) GTEST_SKIP() << "chromium is not installed";
  expect_in_order(text, {"mine saved 60.0 % of the training time of naive (95 % interval 60.0 to 60.0 %); the PSNR of "
                         "mine is equal (+0.00 dB, 95 % interval +0.00 to +0.00 dB).",
                         "Results", "naive\t30,000\t100.00\t-\t-\t-\t25.00",
                         "mine\t30,000\t40.00\t60.0 %\t60.0 to 60.0 %\tfaster\t25.00\t+0.00 dB",
                         "naive_again\t30,000\t102.00\t-2.0 %\t-2.0 to -2.0 %\tslower\t25.25\t+0.25 dB",
                         "Time saved is a share of naive's training time.",
                         "at least the limit, which is 1.0 % of the time.", "Quality",
                         "mine\tPSNR, dB\t100\t25.00 (25.00 to 25.00)\t25.00 (25.00 to 25.00)\t+0.00\t+0.00 to "
                         "+0.00\t0.10\tequal",
                         "Training time", "load balancing alone\ttime saved\t95 % interval\tfinding",
                         "mine against sub-tile\t20.0 %\t20.0 to 20.0 %\tfaster", "kernel switch at 51 (seed 3)",
                         "No configurations here repeat that comparison; --configs paper does.", "garden",
                         "option\tnaive\tsub-tile\tmine", "mine, seed 3", "from segmented to sub-tile",
                         "Load statistics were not recorded"});
  const std::string terminal = describe_comparison(comparison);
  const Json data = comparison_report_data(comparison);
  for (const Json& table : data["tables"]) {
    EXPECT_TRUE(test::contains(terminal, aligned_text(table.get<TextTable>()))) << table << terminal;
  }
}

TEST_F(ReportInBrowser, ShowsPublishedResultsBesideTheSameComparison) {
  const TrainHistory original = steady_history(10), published = steady_history(8, 51), late = steady_history(8);
  const std::string text =
      shown(comparison_of({{"naive-kernels", {original, original}}, {"published", {published, late}}}));
  if (text.empty()) GTEST_SKIP() << "chromium is not installed";
  expect_in_order(text, {"Quality has not been measured yet.",
                         "published against naive-kernels\t20.0 % in 1 of 2 seeds\t20.0 % in 1 of 2 seeds\t20.0 %\t"
                         "20.0 to 20.0 %\tfaster\t51",
                         "in the paper\t19.6 %\t7.9 %\t8.5 %\t-\t-\tabout 2,000"});
}

/// Writes a log like that of a training on a GPU, with everything that a report can show.
void write_eventful_log(const std::filesystem::path& path, double early_ms, double late_ms) {
  std::ofstream file(path);
  double elapsed_s = 0;
  for (int iteration = 10; iteration <= 60; iteration += 10) {
    const double ms = iteration <= 30 ? early_ms : late_ms;
    elapsed_s += 0.01 * ms;
    file << Json{{"iteration", iteration},
                 {"loss", 1.0 / iteration},
                 {"ms", ms},
                 {"count", 1000 + iteration},
                 {"elapsed_s", elapsed_s},
                 {"kernel", iteration <= 30 ? "segmented" : "sub-tile"},
                 {"stages_ms", {{"project", 1}, {"blend_forward", 0.5 * ms}, {"of a later version", 1}}},
                 {"test_psnr", 20 + 0.1 * iteration},
                 {"test_ssim", 0.8}}
         << "\n";
    file << Json{{"iteration", iteration + 1},
                 {"event", "kernel_check"},
                 {"views", 8},
                 {"times_ms", {{"segmented", 1 + 0.01 * iteration}, {"sub-tile", 1.3}}},
                 {"error_ms", 0.02},
                 {"cost_ms", 5},
                 {"before", iteration <= 30 ? "segmented" : "sub-tile"},
                 {"after", iteration < 30 ? "segmented" : "sub-tile"},
                 {"reason", "slower by 3 % <b>"}}
         << "\n";
    const Json load{{"min", 0},    {"median", 30}, {"p90", 400},   {"p99", 2000},
                    {"max", 9000}, {"mean", 90},   {"gini", 0.75}, {"log2_bins", {1, 2, 5, 9, 20, 30, 12, 5, 1}}};
    file << Json{{"iteration", iteration},
                 {"event", "load_statistics"},
                 {"views", 4},
                 {"tile_lists", load},
                 {"pixel_processed", load}}
         << "\n";
  }
}

/// Share of pixels that do not have the most frequent colour, and number of colours.
struct PictureContent {
  double drawn_share = 0;
  std::size_t n_colors = 0;
  int background = 0;  // the red part of the first pixel
};
PictureContent content_of(const Image8& image) {
  std::map<int, std::size_t> counts;
  for (std::size_t i = 0; i < image.pixels.size(); i += 3) {
    ++counts[image.pixels[i] << 16 | image.pixels[i + 1] << 8 | image.pixels[i + 2]];
  }
  std::size_t most = 0;
  for (const auto& [color, n] : counts) most = std::max(most, n);
  return {1 - 3.0 * static_cast<double>(most) / static_cast<double>(image.pixels.size()), counts.size(),
          image.pixels[0]};
}

/// Writes a comparison to disk, of two kernels with one seed.
ComparisonPlan write_eventful_comparison(const std::filesystem::path& root) {
  ComparisonPlan plan;
  plan.base.model_path = root.string();
  plan.base.source_path = "/scenes/<b>garden";
  plan.base.iterations = 60;
  plan.base.eval = true;
  plan.given = {{"iterations", 60}};
  plan.configs = "naive,sub-tile";
  plan.seeds = {0};
  plan.chunk = 25;
  double ms = 40;
  for (const Configuration& own : plan.configurations()) {
    const ModelFolder model = plan.folder(own, 0);
    std::filesystem::create_directories(report_folder(model));
    std::ofstream(model.root() / "config.json") << config_to_json(own.config);
    write_eventful_log(model.log(), ms, 0.25 * ms + 12);
    ms -= 10;
    RunInfo info;
    info.machine = {{"cpu", "a CPU"}, {"cores", 2}};
    info.held_out = true;
    for (const char* name : {"truth.png", "render.png"}) write_image(report_folder(model) / name, Image8(64, 48, 3));
    info.previews = {
        {"</script><img src=x>.jpg", 24.5, report_folder(model) / "truth.png", report_folder(model) / "render.png"}};
    write_run_info(info, model);
  }
  write_plan(plan);
  return plan;
}

TEST_F(ReportInBrowser, DrawsAllChartsOfAComparisonAndOfATraining) {
  const ComparisonPlan plan = write_eventful_comparison(folder_.path() / "out");
  write_comparison(load_comparison(read_plan(plan.root())));
  const Json check = Json::parse(test::read_bytes(plan.root() / "compare.json"))["runs"][0]["kernel_checks"][0];
  EXPECT_EQ(check["error_ms"], 0.02);
  EXPECT_EQ(check["times_ms"]["sub-tile"], 1.3);
  const std::string text = shown(plan.root() / "report.html");
  if (text.empty()) GTEST_SKIP() << "chromium is not installed";
  expect_in_order(text,
                  {"11 charts",
                   "sub-tile and naive ran for too short a time to compare them",
                   "Results",
                   "With one seed, differences below the limit may be chance (\"unclear\")",
                   "Times are \"too short\" to judge with fewer than 10 turns, or less than 10 s of a configuration.",
                   "photograph &lt;/script&gt;&lt;img src=x&gt;.jpg",
                   "naive, PSNR 24.5 dB",
                   "Quality",
                   "sub-tile\tPSNR, dB\t60\t26.00\t26.00\t+0.00\t-\t1.00\tequal",
                   "Training time",
                   "kernel switch at 31",
                   "logical cores\t2",
                   "of a later version",
                   "to sub-tile",
                   "Blending time of both kernels over the training",
                   "6 timing checks took 30 ms, 1.61 % of the training time",
                   "segmented 1.100, sub-tile 1.300\t0.020\t8\tsegmented\tslower by 3 % &lt;b&gt;",
                   "from segmented to sub-tile",
                   "Measured over all tiles and pixels of 4 training views together.",
                   "99th percentile",
                   "Gini coefficient (0 = evenly",
                   "0 = evenly",
                   "iteration 60",
                   "Words"});
  for (const char* missing : {"were not", "not measured yet", "have been rendered"}) {
    EXPECT_FALSE(test::contains(text, missing)) << missing;
  }
  for (const std::string scheme : {"light", "dark"}) {
    const PictureContent content = content_of(read_image(folder_.path() / ("pictures/" + scheme + ".png"), false));
    EXPECT_GT(content.drawn_share, 0.02);
    EXPECT_GT(content.n_colors, 50u);
    EXPECT_EQ(content.background > 128, scheme == "light") << "the background follows the colour scheme";
  }

  const ModelFolder model = plan.folder(plan.configurations()[1], 0);
  const std::string own = shown(write_train_report(model));
  expect_in_order(own, {"10 charts", "&lt;b&gt;garden: trained in 1.49 s, PSNR 26.00 dB on test views, 1,060 Gaussians",
                        "Photographs and renders", "These are test views", "Quality", "PSNR, mean over the test views.",
                        "Time and memory", "forward blending", "Scene, options and machine",
                        "Number of Gaussians in a tile's list", "segmented\t1 to 30\t", "ms per view",
                        "6 timing checks took 30 ms, 2.02 % of the training time", "from segmented to sub-tile"});
}

}  // namespace
}  // namespace b3dgs
