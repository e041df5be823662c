// The report of a comparison, for synthetic runs.
#include "compare/compare_report.h"

#include <gtest/gtest.h>

#include "support/xml.h"

namespace b3dgs {
namespace {

/// Lines every 10 iterations up to 100; switches from combined to shared-memory at `switch_iteration` (0: never).
TrainHistory history(double ms, int switch_iteration = 0) {
  TrainHistory history;
  for (int iteration = 10; iteration <= 100; iteration += 10) {
    LogPoint point;
    point.iteration = iteration;
    point.elapsed_s = 1e-3 * ms * iteration;
    point.kernel = switch_iteration == 0 || iteration < switch_iteration ? "combined" : "shared-memory";
    history.points.push_back(point);
  }
  if (switch_iteration == 0) return history;
  KernelCheckEvent check;
  check.iteration = switch_iteration;
  check.pass = "forward";
  check.times_ms = {{"combined", 2}, {"shared-memory", 1}};
  check.before = "combined";
  check.after = "shared-memory";
  check.reason = "shared-memory takes half";
  history.checks = {check};
  return history;
}

/// Two seeds, 3 and 5, of each.
Comparison comparison_of(const std::vector<std::pair<std::string, std::vector<TrainHistory>>>& configurations) {
  Comparison comparison;
  comparison.plan.base.source_path = "/scenes/garden";
  comparison.plan.seeds = {3, 5};
  std::vector<ConfigurationHistory> histories;
  for (const auto& [name, by_seed] : configurations) {
    comparison.configurations.push_back({name, comparison.plan.base});
    TrainConfig& config = comparison.configurations.back().config;
    config.kernel = find_forward_kernel(name) || name == kPaperKernel ? name : kAdaptive;
    if (name == "original" || name == kPaperKernel) config.backward_kernel = "per-pixel";
    if (name == "original" || name == "naive_again") config.kernel = "naive";
    histories.push_back({name, config, by_seed});
    comparison.runs.emplace_back();
    for (std::size_t i = 0; i < by_seed.size(); ++i) {
      comparison.runs.back().push_back({comparison.plan.seeds[i], by_seed[i], {}});
    }
  }
  comparison.summary = summarize_comparison(histories, 100);
  return comparison;
}

bool contains(const std::string& html, const std::string& part) {
  return html.find(part) != std::string::npos;
}

TEST(CompareReport, SaysHowManySeedsAValueIsOf) {
  const std::string html = comparison_report(
      comparison_of({{"naive", {history(10), history(10)}}, {"adaptive", {history(8, 51), history(8)}}}));
  EXPECT_EQ(test::xml_fault(html), "");
  EXPECT_TRUE(contains(html, "<td>20.0 % in 1 of 2 seeds</td>"));
  EXPECT_TRUE(contains(html, "<td>51 in 1 of 2 seeds</td>"));
  EXPECT_TRUE(contains(html, "kernel switch at 51 (seed 3)")) << "the chart shows one seed and says which";
}

TEST(CompareReport, SeparatesLoadBalancingFromOtherSavings) {
  const TrainHistory naive = history(10), shared = history(5), ours = history(4);
  const std::string html = comparison_report(
      comparison_of({{"naive", {naive, naive}}, {"shared-memory", {shared, shared}}, {"combined", {ours, ours}}}));
  EXPECT_EQ(test::xml_fault(html), "");
  EXPECT_TRUE(contains(html,
                       "<td>combined</td><td>naive</td><td>50.0 % (95 %: 50.0 to 50.0 %)</td><td>shared-memory</td>"
                       "<td>20.0 % (95 %: 20.0 to 20.0 %)</td><td>60.0 % (95 %: 60.0 to 60.0 %)</td>"))
      << html.substr(html.find("saved by load balancing"), 600);
  EXPECT_TRUE(contains(html, "was not measured (--noise does that)"));
  EXPECT_FALSE(contains(html, "±"));
  const std::string without = comparison_report(comparison_of({{"naive", {naive, naive}}, {"combined", {ours, ours}}}));
  EXPECT_TRUE(contains(without, "How much load balancing alone saves is unknown"));
}

TEST(CompareReport, ShowsRunToRunVariationBesideEveryDifference) {
  TrainHistory naive = history(10), again = history(10.2), shared = history(5), ours = history(4, 51);
  for (TrainHistory* own : {&naive, &again, &shared, &ours}) own->points.back().test_psnr = 25;
  again.points.back().test_psnr = 25.25;
  const std::string html = comparison_report(comparison_of({{"naive", {naive, naive}},
                                                            {"shared-memory", {shared, shared}},
                                                            {"mine", {ours, ours}},
                                                            {"naive_again", {again, again}}}));
  EXPECT_EQ(test::xml_fault(html), "");
  EXPECT_TRUE(contains(html, "<td>50.0 % ± 2.0 % (95 %: 50.0 to 50.0 %)</td><td>faster</td>"));
  EXPECT_TRUE(contains(html, "<td>60.0 % ± 2.0 % (60.0 to 60.0)</td><td>60.0 % ± 2.0 % (60.0 to 60.0)</td>"))
      << "also before and after the switch";
  EXPECT_TRUE(contains(html, "<td>+0.00 ± 0.25 (95 %: +0.00 to +0.00)</td><td>equal</td>"));
  EXPECT_TRUE(contains(html, "Run-to-run variation of naive: time 2.0 %, PSNR 0.25."));
  EXPECT_TRUE(contains(html, "two runs of naive differ by 2.0 %."));
}

TEST(CompareReport, ShowsPublishedResultsBesideTheSameComparison) {
  const TrainHistory original = history(10), paper = history(8, 51);
  const std::string html =
      comparison_report(comparison_of({{"original", {original, original}}, {"paper", {paper, paper}}}));
  EXPECT_EQ(test::xml_fault(html), "");
  EXPECT_TRUE(contains(html, "<td>paper against original</td><td>20.0 % (95 %: 20.0 to 20.0 %)</td><td>faster</td>"));
  EXPECT_TRUE(contains(html, "<td>published</td><td>8.5 %</td><td></td><td>19.6 %</td><td>7.9 %</td>"));
  const std::string ours =
      comparison_report(comparison_of({{"naive", {original, original}}, {"adaptive", {paper, paper}}}));
  EXPECT_FALSE(contains(ours, "<td>published</td>")) << "the paper used another backward pass";
  EXPECT_TRUE(contains(ours, "No configurations here repeat that comparison"));
}

TEST(CompareReport, BeginsWithPicturesAndQualityAndFoldsTheRest) {
  TrainHistory naive = history(10), ours = history(8);
  naive.points.back().test_psnr = ours.points.back().test_psnr = 25;
  const std::string html = comparison_report(comparison_of({{"naive", {naive, naive}}, {"combined", {ours, ours}}}));
  EXPECT_EQ(test::xml_fault(html), "");
  std::size_t at = 0;
  for (const char* part :
       {"<h1>", "<h2>Photographs and renders", "<h2>Quality", "<h2>Training time",
        "<td>naive (baseline)</td><td>1.00 s (1.0 to 1.0)</td>", "<td>combined</td><td>0.80 s (0.8 to 0.8)</td>",
        "<h2>Scene, options and machine", "/scenes/garden", "<th>option</th><th>naive</th><th>combined</th>",
        "<td>kernel</td><td>naive</td><td>combined</td>", "<details>\n<summary>Time by stage",
        "<details>\n<summary>Kernels", "<details>\n<summary>Load", "<details>\n<summary>Published results"}) {
    const std::size_t next = html.find(part, at);
    ASSERT_NE(next, std::string::npos) << part << " is missing or in the wrong place";
    at = next;
  }
  EXPECT_FALSE(contains(html, "<th>before the switch</th>")) << "no kernel was switched";
}

TEST(CompareReport, NamesOptionsOfAllOnlyWhereTheyAre) {
  Comparison comparison = comparison_of({{"naive", {history(10), history(10)}}, {"mine", {history(8), history(8)}}});
  comparison.plan.base.gaussians_per_pixel = 1.5;  // of the default preset, which both configurations override
  comparison.plan.base.lambda_dssim = 0.3;
  for (Configuration& own : comparison.configurations) {
    own.config.gaussians_per_pixel = 2.5;
    own.config.kernel = "naive";
  }
  comparison.configurations[0].config.lambda_dssim = 0.1;
  comparison.configurations[1].config.lambda_dssim = 0.4;
  comparison.summary = summarize_comparison({{"naive", comparison.configurations[0].config, {history(10), history(10)}},
                                             {"mine", comparison.configurations[1].config, {history(8), history(8)}}},
                                            100);
  const std::string html = comparison_report(comparison);
  EXPECT_EQ(test::xml_fault(html), "");
  const std::string all = html.substr(html.find("<td>options of all</td>"), 300);
  EXPECT_TRUE(contains(all, "gaussians_per_pixel 2.5")) << all;
  EXPECT_FALSE(contains(all.substr(0, all.find("</tr>")), "lambda_dssim")) << all;
  EXPECT_FALSE(contains(html, "gaussians_per_pixel 1.5"));
  EXPECT_TRUE(contains(html, "<td>lambda_dssim</td><td>0.1</td><td>0.4</td>")) << all;
  EXPECT_TRUE(contains(html, "<td>lambda_dssim 0.1 → 0.4</td>")) << "few options are named beside the time";
}

TEST(CompareReport, ManyOptionsAreListedOnce) {
  Comparison comparison = comparison_of({{"naive", {history(10), history(10)}}, {"mine", {history(8), history(8)}}});
  TrainConfig& mine = comparison.configurations[1].config;
  mine.kernel = "naive";
  mine.feature_lr = 0.123;
  mine.opacity_lr = 0.234;
  mine.scaling_lr = 0.345;
  mine.rotation_lr = 0.456;
  comparison.summary = summarize_comparison({{"naive", comparison.configurations[0].config, {history(10), history(10)}},
                                             {"mine", mine, {history(8), history(8)}}},
                                            100);
  const std::string html = comparison_report(comparison);
  EXPECT_TRUE(contains(html, "<td>4 options (see below)</td>"));
  EXPECT_EQ(html.find("0.345"), html.rfind("0.345")) << "once";
  EXPECT_NE(html.find("0.345"), std::string::npos);
}

TEST(CompareReport, TheTableOnTheTerminalHasNoEmptyColumns) {
  const std::string fixed = describe_comparison(
      comparison_of({{"naive", {history(10), history(10)}}, {"combined", {history(8), history(8)}}}));
  EXPECT_FALSE(contains(fixed, "switch")) << fixed;
  EXPECT_TRUE(contains(fixed, "20.0 to 20.0 %  faster")) << fixed;
  const std::string switched = describe_comparison(
      comparison_of({{"naive", {history(10), history(10)}}, {"mine", {history(8, 51), history(8, 51)}}}));
  EXPECT_TRUE(contains(switched, "before switch  after switch")) << switched;
  Comparison one = comparison_of({{"naive", {history(10)}}, {"combined", {history(9.5)}}});
  EXPECT_FALSE(contains(describe_comparison(one), "interval")) << describe_comparison(one);
  EXPECT_TRUE(contains(describe_comparison(one), "5.0 %  unclear")) << describe_comparison(one);
}

TEST(CompareReport, SaysHowLongLoadingTheKernelsTook) {
  Comparison comparison = comparison_of({{"naive", {history(10), history(10)}}, {"mine", {history(8), history(8)}}});
  EXPECT_FALSE(contains(comparison_report(comparison), "loading the candidate kernels"));
  comparison.plan.loading_ms = 87;
  EXPECT_TRUE(
      contains(comparison_report(comparison), "The times of mine include 87 ms for loading the candidate kernels"));
}

TEST(CompareReport, NamesTheRunsWithTimingChecks) {
  const std::string html = comparison_report(comparison_of({{"naive", {history(10), history(10)}},
                                                            {"adaptive", {history(8), history(8, 51)}},
                                                            {"mine", {history(8, 31), history(8, 51)}}}));
  EXPECT_EQ(test::xml_fault(html), "");
  EXPECT_TRUE(contains(html, "<h3>adaptive, seed 5</h3>")) << "the first seed has no checks";
  EXPECT_TRUE(contains(html, "<h3>mine, seed 3</h3>"));
  EXPECT_FALSE(contains(html, "<h3>naive"));
  EXPECT_TRUE(contains(html, "Load statistics were not recorded")) << "in no run";
}

TEST(CompareReport, ShowsTheLoadOfOursAndTimesOfFixedKernels) {
  TrainHistory timed = history(10);
  timed.loads = {{1, LoadFigures{1, 2, 3, 4, 5, 2, 0.5, {0, 1, 2}}, {}, {}}};
  timed.candidate_times = {{1, "forward", {{"combined", 1.5}, {"shared-memory", 2}}}};
  const std::string html = comparison_report(
      comparison_of({{"naive", {timed, timed}}, {"combined", {history(8), timed}}, {"dynamic", {timed, timed}}}));
  EXPECT_EQ(test::xml_fault(html), "");
  const std::string heading = "<h3>combined, seed 5</h3>";  // the first seed has neither
  const std::size_t kernels = html.find(heading);
  ASSERT_NE(kernels, std::string::npos);
  EXPECT_NE(html.find(heading, kernels + 1), std::string::npos) << "in the sections on kernels and load";
  EXPECT_FALSE(contains(html, "<h3>naive") || contains(html, "<h3>dynamic")) << "one represents all";
  EXPECT_TRUE(contains(html, "Time of the forward kernels: combined 1.50 ms, shared-memory 2 ms (iteration 1)."));
}

}  // namespace
}  // namespace b3dgs
