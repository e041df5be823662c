// Results of a comparison, for synthetic histories.
#include "compare/compare_summary.h"

#include <gtest/gtest.h>

#include <cmath>

#include "compare/compare_verdict.h"
#include "compare/synthetic_histories.h"

namespace b3dgs {
namespace {

using namespace test;

TEST(CompareSummary, InterpolatesElapsedTime) {
  const TrainHistory curve = history(10, 20);
  EXPECT_DOUBLE_EQ(elapsed_at(curve, 0), 0);
  EXPECT_NEAR(elapsed_at(curve, 5), 0.05, 1e-12);
  EXPECT_NEAR(elapsed_at(curve, 2000), 20, 1e-9);
  EXPECT_NEAR(elapsed_at(curve, 2005), 20.1, 1e-9);
  EXPECT_NEAR(elapsed_at(curve, 9999), 60, 1e-9) << "constant after the last line";
  EXPECT_EQ(elapsed_at(TrainHistory{}, 100), 0);
}

TEST(CompareSummary, SplitsTimeSavedAtTheKernelSwitch) {
  const auto saved = time_saved(history(10, 10), with_switch(history(8, 9.5), 2001));
  ASSERT_TRUE(saved);
  EXPECT_EQ(saved->switch_iteration, 2001);
  EXPECT_NEAR(saved->before.value(), 0.2, 1e-9);
  EXPECT_NEAR(saved->after.value(), 0.05, 1e-9);
  EXPECT_NEAR(saved->overall, 0.125, 1e-9);
  EXPECT_NEAR(saved->baseline_s, 40, 1e-9);
  EXPECT_NEAR(saved->ours_s, 35, 1e-9);
}

TEST(CompareSummary, WithoutAKernelSwitchThereIsNoBeforeAndAfter) {
  const auto saved = time_saved(history(10, 10), history(8, 8));
  ASSERT_TRUE(saved);
  EXPECT_FALSE(saved->switch_iteration);
  EXPECT_FALSE(saved->before);
  EXPECT_FALSE(saved->after);
  EXPECT_NEAR(saved->overall, 0.2, 1e-9);
  EXPECT_FALSE(time_saved(history(10, 10), TrainHistory{}));

  const auto from_the_start = time_saved(history(10, 10), with_switch(history(8, 8), 1));
  ASSERT_TRUE(from_the_start);
  EXPECT_FALSE(from_the_start->before) << "there is no time before the first step";
  EXPECT_NEAR(from_the_start->after.value(), 0.2, 1e-3);

  TrainHistory backward = with_switch(history(8, 8), 2000);
  for (KernelCheckEvent& check : backward.checks) check.pass = "backward";
  EXPECT_FALSE(first_kernel_switch(backward));
  EXPECT_FALSE(first_kernel_switch(TrainHistory{}));
}

TEST(CompareSummary, KernelPeriodsFollowLinesAndChecks) {
  EXPECT_TRUE(kernel_periods(history(10, 10)).empty());
  const std::vector<KernelPeriod> late = kernel_periods(with_switch(history(10, 10), 2000));
  ASSERT_EQ(late.size(), 2u);
  EXPECT_EQ(late[0].kernel, "combined");
  EXPECT_EQ(late[0].until, 1999) << "the check runs before the step of its iteration";
  EXPECT_EQ(late[1].from, 1999);
  EXPECT_EQ(late[1].until, 4000);
  const std::vector<KernelPeriod> early = kernel_periods(with_switch(history(10, 10), 1));
  ASSERT_EQ(early.size(), 1u);
  EXPECT_EQ(early[0].kernel, "shared-memory");
  EXPECT_EQ(early[0].from, 0);

  TrainHistory resumed = with_kernel(history(10, 10), "dynamic");  // with another kernel, without a check
  for (LogPoint& point : resumed.points) point.kernel = point.iteration > 1000 ? "naive" : "dynamic";
  EXPECT_EQ(kernel_periods(resumed).at(0).until, 1000);
}

TEST(CompareSummary, TheVerdictIsAboutTheFirstAdaptiveConfiguration) {
  const ComparisonSummary summary =
      summarize_comparison({trained("naive", {history(10, 10)}), trained("shared-memory", {history(9, 9)}),
                            trained("adaptive", {history(8, 8)})},
                           4000);
  EXPECT_EQ(summary.baseline, "naive");
  EXPECT_EQ(summary.ours, "adaptive");
  EXPECT_EQ(summary.compared.size(), 2u);
  EXPECT_NEAR(summary.find("shared-memory")->overall->mean, 0.1, 1e-9);
  EXPECT_EQ(summary.find("nobody"), nullptr);
}

TEST(CompareSummary, SeparatesTheGainOfLoadBalancing) {
  const ComparisonSummary summary = summarize_comparison(
      {trained("naive", {history(10, 10), history(10, 10)}), trained("shared-memory", {history(5, 5), history(5, 5)}),
       trained("segmented", {history(4, 4), history(3, 3)})},
      4000);
  ASSERT_EQ(summary.balancing.size(), 1u) << "only for the balanced configuration";
  const BalancingGain& gain = summary.balancing[0];
  EXPECT_EQ(gain.name, "segmented");
  EXPECT_EQ(gain.naive, "naive");
  EXPECT_EQ(gain.unbalanced, "shared-memory");
  EXPECT_NEAR(gain.to_unbalanced.mean, 0.5, 1e-9);
  EXPECT_NEAR(gain.balancing.min, 0.2, 1e-9);
  EXPECT_NEAR(gain.balancing.max, 0.4, 1e-9);
  EXPECT_NEAR(gain.whole.mean, 0.65, 1e-9);
  const auto json = to_json(summary)["balancing"][0];
  EXPECT_NEAR(json["saved_by_balancing"]["mean"].get<double>(), 0.3, 1e-9);
  EXPECT_NEAR(json["saved_naive_to_unbalanced"]["mean"].get<double>(), 0.5, 1e-9);
  EXPECT_NEAR(json["saved_whole"]["mean"].get<double>(), 0.65, 1e-9);
}

TEST(CompareSummary, TheGainNeedsEveryUnbalancedKernelWithTheSameOptions) {
  ConfigurationHistory other = trained("shared-memory", {history(5, 5)});
  const std::vector<ConfigurationHistory> same{trained("naive", {history(10, 10)}), other,
                                               trained("adaptive", {history(4, 4)})};
  EXPECT_EQ(summarize_comparison(same, 4000).balancing.size(), 1u);
  other.config.culling = "square";
  const ComparisonSummary summary =
      summarize_comparison({trained("naive", {history(10, 10)}), other, trained("adaptive", {history(4, 4)})}, 4000);
  EXPECT_TRUE(summary.balancing.empty());
  EXPECT_EQ(summary.missing_kernels, (std::vector<std::string>{"shared-memory"}));
  EXPECT_EQ(summary.compared[0].differs_in, (std::vector<std::string>{"culling"}));
  EXPECT_TRUE(summary.compared[1].differs_in.empty()) << "it differs only in the forward kernel";
  EXPECT_TRUE(summary.compared[1].has_own_kernel);
}

TEST(CompareSummary, KnowsWhichKernelsAreBalanced) {
  EXPECT_FALSE(is_balanced_kernel("naive") || is_balanced_kernel("shared-memory") || is_balanced_kernel("no kernel"));
  for (const char* name : {"dynamic", "gaussian-wise", "combined", "segmented"}) {
    EXPECT_TRUE(is_balanced_kernel(name)) << name;
  }
  EXPECT_TRUE(may_balance(config_with("adaptive")) && may_balance(config_with("published")));
  EXPECT_FALSE(may_balance(config_with("shared-memory")));
}

TEST(CompareSummary, ARepeatedBaselineGivesTheRunToRunVariation) {
  const ComparisonSummary summary = summarize_comparison(
      {trained("naive", {with_quality(history(10, 10), 25, 1000), with_quality(history(10, 10), 26, 1000)}),
       trained("ours", {with_quality(with_switch(history(8, 9.5), 2001), 25.3, 1000),
                        with_quality(with_switch(history(8, 9.5), 2001), 26, 1000)}),
       {"again",
        config_with("naive"),
        {with_quality(history(10.1, 10), 25.2, 1000), with_quality(history(10, 9.6), 25.9, 1010)}}},
      4000);
  EXPECT_EQ(summary.repetition, "again");
  EXPECT_NEAR(summary.noise().value(), 0.02, 1e-9) << "the larger of 0.5 and 2 %";
  const ComparedConfiguration& ours = summary.compared[0];
  EXPECT_NEAR(ours.noise.overall.value(), 0.02, 1e-9);
  EXPECT_NEAR(ours.noise.before.value(), 0.01, 1e-9);
  EXPECT_NEAR(ours.noise.after.value(), 0.04, 1e-9);
  EXPECT_NEAR(ours.quality[0].noise.value(), 0.2, 1e-9);
  const auto json = to_json(summary);
  EXPECT_EQ(json["repetition"], "again");
  EXPECT_NEAR(json["machine_spread"].get<double>(), 0.02, 1e-9);
  EXPECT_NEAR(json["compared"][0]["machine_spread"]["after"].get<double>(), 0.04, 1e-9);
  EXPECT_NEAR(json["compared"][0]["quality"][0]["machine_spread"].get<double>(), 0.2, 1e-9);
  EXPECT_EQ(describe_repetition(summary),
            "run-to-run variation of naive: time 2.0 %, PSNR 0.20, SSIM 0.0000, Gaussians 10");
  EXPECT_EQ(summarize_pair({history(10, 10)}, {history(8, 8)}).noise(), std::nullopt);
}

TEST(CompareSummary, ADifferenceWithinRunToRunVariationIsNeitherEqualNorADifference) {
  const ComparisonSummary summary =
      summarize_comparison({trained("naive", {with_quality(history(10, 10), 25, 1000)}),
                            trained("ours", {with_quality(history(8, 8), 25.4, 1000)}),
                            {"again", config_with("naive"), {with_quality(history(10, 10), 24.5, 1000)}}},
                           4000);
  const Effect& gained = summary.compared[0].quality[0].gained;
  EXPECT_EQ(gained.finding, Finding::kUnclear);
  EXPECT_NEAR(gained.limit, 12.706 * 0.5, 1e-9);
  EXPECT_NE(quality_criterion(summary).find("12.7 times the run-to-run variation"), std::string::npos);
}

TEST(CompareSummary, OnlyTheSameComparisonIsSetBesideThePaper) {
  const auto original = [](const std::string& kernel) {
    ConfigurationHistory own = trained(kernel, {with_switch(history(8, 9.5), 2001)});
    own.name = "original_" + kernel;
    own.config.backward_kernel = "per-pixel";
    return own;
  };
  const ComparisonSummary summary =
      summarize_comparison({trained("naive", {history(10, 10)}), trained("published", {history(9, 9)}),
                            original("naive"), original("adaptive"), original("published"), original("combined")},
                           4000);
  ASSERT_EQ(summary.paper_comparisons.size(), 1u) << "not with another backward pass, another pair or a fixed kernel";
  EXPECT_EQ(summary.paper_comparisons[0].baseline, "original_naive");
  EXPECT_EQ(summary.paper_comparisons[0].name, "original_published");
  EXPECT_TRUE(summary.paper_comparisons[0].before);
  EXPECT_EQ(to_json(summary)["beside_paper"][0]["baseline"], "original_naive");
}

TEST(CompareSummary, QualityIsComparedSeedBySeed) {
  const auto quality = [](std::vector<double> naive, std::vector<double> ours) {
    std::vector<TrainHistory> a, b;
    for (const double psnr : naive) a.push_back(with_quality(history(10, 10), psnr, 1000));
    for (const double psnr : ours) b.push_back(with_quality(history(8, 8), psnr, 1100));
    return summarize_pair(a, b).compared[0].quality;
  };
  const std::vector<QualityDifference> paired = quality({25, 26, 27}, {24.7, 25.68, 26.72});
  ASSERT_EQ(paired.size(), 3u);
  EXPECT_EQ(paired[0].gained.finding, Finding::kDiffers) << "each seed lost 0.3 dB, though seeds differ by 2 dB";
  EXPECT_NEAR(paired[0].gained.mean, -0.3, 1e-9);
  EXPECT_NEAR(paired[0].gained.margin.value(), 4.303 * 0.02 / std::sqrt(3), 1e-9);
  EXPECT_EQ(paired[1].gained.finding, Finding::kEqual);
  EXPECT_EQ(paired[2].gained.finding, Finding::kDiffers) << "a tenth more Gaussians";
  EXPECT_EQ(quality({25, 25, 25}, {25.05, 25.06, 25.04})[0].gained.finding, Finding::kEqual) << "within 0.1 dB";
  EXPECT_EQ(quality({25, 25, 25}, {25.5, 24.6, 25.3})[0].gained.finding, Finding::kUnclear);
  EXPECT_EQ(quality({25, 25.5}, {25.3, 25.9})[0].gained.finding, Finding::kUnclear) << "two seeds tell little";
  const auto json = to_json(summarize_pair({with_quality(history(10, 10), 25, 9), with_quality(history(10, 10), 25, 9)},
                                           {with_quality(history(8, 8), 26, 9), with_quality(history(8, 8), 26, 9)}));
  EXPECT_EQ(json["compared"][0]["quality"][0]["finding"], "differs");
  EXPECT_EQ(json["compared"][0]["quality"][0]["interval"], nlohmann::ordered_json::array({1.0, 1.0}));
  EXPECT_EQ(json["compared"][0]["quality"][0]["tolerance"], 0.1);
  EXPECT_TRUE(summarize_pair({history(10, 10)}, {history(8, 8)}).compared[0].quality.empty()) << "nothing measured";
}

TEST(CompareSummary, OneSeedSaysLittleOfQualityAndTime) {
  const auto compared = [](double psnr, double ms) {
    return summarize_pair({with_quality(history(10, 10), 25, 1000)}, {with_quality(history(ms, ms), psnr, 1000)})
        .compared[0];
  };
  EXPECT_EQ(compared(25, 10).quality[0].gained.finding, Finding::kUnclear) << "not equal, either";
  EXPECT_EQ(compared(24.5, 10).quality[0].gained.finding, Finding::kUnclear);
  EXPECT_EQ(compared(23.5, 10).quality[0].gained.finding, Finding::kDiffers);
  EXPECT_EQ(compared(25, 9.5).overall->finding, Finding::kUnclear);
  EXPECT_EQ(compared(25, 8.5).overall->finding, Finding::kDiffers);
  EXPECT_FALSE(compared(25, 8.5).overall->margin);
}

TEST(CompareSummary, QualityIsComparedWhereAllWereMeasured) {
  const auto measured_at = [](TrainHistory history, std::vector<std::pair<int, double>> psnr) {
    for (const auto& [iteration, value] : psnr) {
      history.points.at(static_cast<std::size_t>(iteration / 10 - 1)).test_psnr = value;
    }
    return history;
  };
  const std::vector<QualityDifference> quality =
      summarize_pair({measured_at(history(10, 10), {{1000, 20}, {4000, 25}})},
                     {measured_at(history(8, 8, 3000), {{1000, 20.05}, {2000, 23}})})
          .compared[0]
          .quality;
  ASSERT_EQ(quality.size(), 1u);
  EXPECT_EQ(quality[0].iteration, 1000);
  EXPECT_EQ(quality[0].baseline.mean, 20);
  EXPECT_EQ(quality[0].ours.mean, 20.05);

  // A second seed that has not come as far does not count, nor change what is compared.
  const ComparisonSummary two = summarize_pair(
      {measured_at(history(10, 10), {{1000, 20}, {4000, 25}}), measured_at(history(10, 10, 2000), {{1000, 10}})},
      {measured_at(history(8, 8), {{1000, 20}, {4000, 25.2}}), measured_at(history(8, 8, 2000), {{1000, 10}})});
  const QualityDifference& last = two.compared[0].quality.at(0);
  EXPECT_EQ(last.iteration, 4000);
  EXPECT_EQ(last.baseline.n, 1);
  EXPECT_EQ(last.ours.mean, 25.2);
  EXPECT_EQ(last.gained.limit, 1) << "the range of one seed says nothing";
  EXPECT_NE(quality_criterion(two).find("PSNR, dB 1; SSIM 0.03; Gaussians 20 %"), std::string::npos)
      << quality_criterion(two);
}

TEST(CompareSummary, BeforeAndAfterAreOfTheSameSeeds) {
  const TrainHistory naive = history(10, 10);
  const ComparedConfiguration compared =
      summarize_pair({naive, naive, naive}, {with_switch(history(8, 9.5), 2001), with_switch(history(9, 9), 1),
                                             with_kernel(history(7, 7), "combined")})
          .compared[0];
  ASSERT_TRUE(compared.before && compared.after);
  EXPECT_EQ(compared.before->n, 1);
  EXPECT_EQ(compared.after->n, 1) << "the second seed has an after, but no before";
  EXPECT_NEAR(compared.after->mean, 0.05, 1e-9);
  EXPECT_EQ(compared.switch_iteration->n, 2);
  EXPECT_EQ(compared.overall->n, 3);
  EXPECT_EQ(in_seeds(compared.before->n, compared.overall->n), " in 1 of 3 seeds");
  EXPECT_EQ(in_seeds(3, 3), "");
}

TEST(CompareSummary, IsWrittenAsJson) {
  const auto json = to_json(summarize_pair({history(10, 10)}, {with_switch(history(8, 9.5), 2001)}));
  EXPECT_EQ(json["compared"][0]["inflection"]["mean"], 2001);
  EXPECT_EQ(json["compared"][0]["balanced_kernels"]["names"], nlohmann::ordered_json::array({"combined"}));
  EXPECT_EQ(json["compared"][0]["balanced_kernels"]["iterations"]["mean"], 2000);
  EXPECT_NEAR(json["compared"][0]["other_kernels"]["saved_against_baseline"]["mean"].get<double>(), 0.05, 1e-9);
  EXPECT_TRUE(json["machine_spread"].is_null());
  EXPECT_NEAR(json["compared"][0]["saved_before_inflection"]["mean"].get<double>(), 0.2, 1e-9);
  EXPECT_EQ(json["compared"][0]["saved_overall"]["n"], 1);
  EXPECT_TRUE(to_json(summarize_pair({history(10, 10)}, {history(8, 8)}))["compared"][0]["inflection"].is_null());
}

}  // namespace
}  // namespace b3dgs
