// What the page of a comparison says, over invented runs.
#include "compare/compare_report.h"

#include <gtest/gtest.h>

#include "support/xml.h"

namespace b3dgs {
namespace {

/// Lines every 10 iterations up to 100, with one kernel up to `inflection` and another from there on.
TrainHistory history(double ms, int inflection = 0) {
  TrainHistory history;
  for (int iteration = 10; iteration <= 100; iteration += 10) {
    LogPoint point;
    point.iteration = iteration;
    point.elapsed_s = 1e-3 * ms * iteration;
    point.kernel = inflection == 0 || iteration < inflection ? "combined" : "shared-memory";
    history.points.push_back(point);
  }
  if (inflection == 0) return history;
  KernelCheckEvent check;
  check.iteration = inflection;
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

TEST(CompareReport, SaysHowManySeedsAFigureIsOf) {
  const std::string html = comparison_report(
      comparison_of({{"naive", {history(10), history(10)}}, {"adaptive", {history(8, 51), history(8)}}}));
  EXPECT_EQ(test::xml_fault(html), "");
  EXPECT_TRUE(contains(html, "<td>20.0 % in 1 of 2 seeds</td>"));
  EXPECT_TRUE(contains(html, "<td>51 in 1 of 2 seeds</td>"));
  EXPECT_TRUE(contains(html, "inflection of seed 3, 51")) << "the chart shows one seed, and says which";
}

TEST(CompareReport, TellsThreeNumbersApart) {
  const TrainHistory naive = history(10), shared = history(5), ours = history(4);
  const std::string html = comparison_report(
      comparison_of({{"naive", {naive, naive}}, {"shared-memory", {shared, shared}}, {"combined", {ours, ours}}}));
  EXPECT_EQ(test::xml_fault(html), "");
  EXPECT_TRUE(contains(html,
                       "<td>combined</td><td>naive</td><td>50.0 % (50.0 to 50.0)</td><td>shared-memory</td>"
                       "<td>20.0 % (20.0 to 20.0)</td><td>60.0 % (60.0 to 60.0)</td>"))
      << html.substr(html.find("saved from there"), 600);
  EXPECT_TRUE(contains(html, "was not measured (--noise)"));
  EXPECT_FALSE(contains(html, "±"));
  const std::string without = comparison_report(comparison_of({{"naive", {naive, naive}}, {"combined", {ours, ours}}}));
  EXPECT_TRUE(contains(without, "What balancing brings by itself cannot be told here"));
}

TEST(CompareReport, ShowsTheMachinesSpreadBesideEveryDifference) {
  TrainHistory naive = history(10), again = history(10.2), shared = history(5), ours = history(4, 51);
  for (TrainHistory* own : {&naive, &again, &shared, &ours}) own->points.back().test_psnr = 25;
  again.points.back().test_psnr = 25.25;
  const std::string html = comparison_report(comparison_of({{"naive", {naive, naive}},
                                                            {"shared-memory", {shared, shared}},
                                                            {"mine", {ours, ours}},
                                                            {"naive_again", {again, again}}}));
  EXPECT_EQ(test::xml_fault(html), "");
  EXPECT_TRUE(contains(html, "<td>50.0 % ± 2.0 % (50.0 to 50.0)</td>"));
  EXPECT_TRUE(contains(html, "<td>60.0 % ± 2.0 % (60.0 to 60.0)</td><td>60.0 % ± 2.0 % (60.0 to 60.0)</td>"))
      << "before and after the inflection too";
  EXPECT_TRUE(contains(html, "<td>+0.00 ± 0.25</td>"));
  EXPECT_TRUE(contains(html, "Naive against itself (naive_again): time 2.0 %, PSNR 0.25."));
  EXPECT_TRUE(contains(html, "naive differs from itself by 2.0 %."));
}

TEST(CompareReport, ThePapersFiguresStandBesideWhatIsMeasuredAsItDid) {
  const TrainHistory original = history(10), paper = history(8, 51);
  const std::string html =
      comparison_report(comparison_of({{"original", {original, original}}, {"paper", {paper, paper}}}));
  EXPECT_EQ(test::xml_fault(html), "");
  EXPECT_TRUE(contains(html, "<td>paper against original</td><td>20.0 % (20.0 to 20.0)</td>"));
  EXPECT_TRUE(contains(html, "<td>the paper</td><td>19.6 %</td><td>7.9 %</td><td>8.5 %</td>"));
  const std::string ours =
      comparison_report(comparison_of({{"naive", {original, original}}, {"adaptive", {paper, paper}}}));
  EXPECT_FALSE(contains(ours, "<td>the paper</td>")) << "our backward pass on both sides";
  EXPECT_TRUE(contains(ours, "Nothing here compares with that"));
}

TEST(CompareReport, SaysWhatLoadingTheCandidatesTook) {
  Comparison comparison = comparison_of({{"naive", {history(10), history(10)}}, {"mine", {history(8), history(8)}}});
  EXPECT_FALSE(contains(comparison_report(comparison), "loading the candidates"));
  comparison.plan.loading_ms = 87;
  EXPECT_TRUE(contains(comparison_report(comparison), "In the times of mine: 87 ms for loading the candidates"));
}

TEST(CompareReport, NamesTheRunsThatMeasured) {
  const std::string html = comparison_report(comparison_of({{"naive", {history(10), history(10)}},
                                                            {"adaptive", {history(8), history(8, 51)}},
                                                            {"mine", {history(8, 31), history(8, 51)}}}));
  EXPECT_EQ(test::xml_fault(html), "");
  EXPECT_TRUE(contains(html, "<h3>adaptive, seed 5</h3>")) << "its first seed has no checks";
  EXPECT_TRUE(contains(html, "<h3>mine, seed 3</h3>"));
  EXPECT_FALSE(contains(html, "<h3>naive"));
  EXPECT_TRUE(contains(html, "Load statistics were not taken")) << "of nobody";
}

TEST(CompareReport, ShowsTheLoadOfOursAndTimesOfFixedKernels) {
  TrainHistory timed = history(10);
  timed.loads = {{1, LoadFigures{1, 2, 3, 4, 5, 2, 0.5, {0, 1, 2}}, {}, {}}};
  timed.candidate_times = {{1, "forward", {{"combined", 1.5}, {"shared-memory", 2}}}};
  const std::string html = comparison_report(
      comparison_of({{"naive", {timed, timed}}, {"combined", {history(8), timed}}, {"dynamic", {timed, timed}}}));
  EXPECT_EQ(test::xml_fault(html), "");
  const std::string heading = "<h3>combined, seed 5</h3>";  // its first seed has neither
  const std::size_t kernels = html.find(heading);
  ASSERT_NE(kernels, std::string::npos);
  EXPECT_NE(html.find(heading, kernels + 1), std::string::npos) << "kernels and load";
  EXPECT_FALSE(contains(html, "<h3>naive") || contains(html, "<h3>dynamic")) << "one stands for all";
  EXPECT_TRUE(contains(html, "Time of the forward candidates over the training"));
}

}  // namespace
}  // namespace b3dgs
