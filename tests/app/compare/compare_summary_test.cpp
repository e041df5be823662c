// Results of a comparison, for synthetic histories.
#include "app/compare/compare_summary.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "app/compare/synthetic_histories.h"

namespace b3dgs {
namespace {

using namespace test;
using Json = nlohmann::ordered_json;

std::vector<std::string> sorted_keys(const Json& json) {
  std::vector<std::string> keys;
  for (const auto& [key, value] : json.items()) keys.push_back(key);
  std::sort(keys.begin(), keys.end());
  return keys;
}

TEST(CompareSummary, ItsKeysStay) {
  const Json summary = summarize_pair({history(10, 10)}, {history(8, 8)});
  using Keys = std::vector<std::string>;
  EXPECT_EQ(sorted_keys(summary),
            (Keys{"balancing", "baseline", "beside_paper", "compared", "done", "done_by_seed", "holds_out_views",
                  "iterations", "machine_spread", "ours", "repetition", "results", "verdict"}));
  EXPECT_EQ(sorted_keys(summary["compared"][0]),
            (Keys{"baseline", "by_seed", "inflection", "name", "quality", "saved_after_inflection",
                  "saved_before_inflection", "saved_overall"}));
  EXPECT_EQ(sorted_keys(summary["results"][0]),
            (Keys{"complete_seeds", "gaussians", "iterations", "name", "psnr", "psnr_gained", "seconds", "ssim"}));
}

TEST(CompareSummary, SplitsTimeSavedAtTheKernelSwitch) {
  const Json saved = summarize_pair({history(10, 10)}, {with_switch(history(8, 9.5), 2001)})["compared"][0];
  EXPECT_EQ(saved["inflection"]["mean"], 2001);
  EXPECT_NEAR(saved["saved_before_inflection"]["mean"], 0.2, 1e-9);
  EXPECT_NEAR(saved["saved_after_inflection"]["mean"], 0.05, 1e-9);
  EXPECT_NEAR(saved["saved_overall"]["mean"], 0.125, 1e-9);
  EXPECT_EQ(saved["saved_overall"]["n"], 1);
  EXPECT_NEAR(saved["by_seed"][0]["baseline_s"], 40, 1e-9);
  EXPECT_NEAR(saved["by_seed"][0]["ours_s"], 35, 1e-9);

  // Between log lines, time is interpolated.
  const Json between = summarize_pair({history(10, 10)}, {with_switch(history(8, 9.5), 2006)})["compared"][0];
  EXPECT_NEAR(between["saved_before_inflection"]["mean"], (20.05 - 16.0475) / 20.05, 1e-9);
}

TEST(CompareSummary, WithoutAKernelSwitchThereIsNoBeforeAndAfter) {
  const Json saved = summarize_pair({history(10, 10)}, {history(8, 8)})["compared"][0];
  EXPECT_TRUE(saved["inflection"].is_null());
  EXPECT_TRUE(saved["saved_before_inflection"].is_null());
  EXPECT_TRUE(saved["saved_after_inflection"].is_null());
  EXPECT_NEAR(saved["saved_overall"]["mean"], 0.2, 1e-9);
  EXPECT_TRUE(summarize_pair({history(10, 10)}, {TrainHistory{}})["compared"][0]["saved_overall"].is_null());

  TrainHistory checked = with_kernel(history(8, 8), "segmented");
  checked.events["kernel_check"].push_back(check(1009, "segmented", "sub-tile", false));
  EXPECT_TRUE(summarize_pair({history(10, 10)}, {checked})["compared"][0]["inflection"].is_null());
}

TEST(CompareSummary, TheInflectionIsTheFirstOfSeveralSwitches) {
  TrainHistory back = with_switch(history(8, 9.5), 2001);
  back.events["kernel_check"].push_back(check(3001, "sub-tile", "segmented", true));
  for (LogPoint& point : back.points) point.kernel = point.iteration >= 3001 ? "segmented" : point.kernel;
  const Json saved = summarize_pair({history(10, 10)}, {back})["compared"][0];
  EXPECT_EQ(saved["inflection"]["mean"], 2001);
  EXPECT_NEAR(saved["saved_after_inflection"]["mean"], 0.05, 1e-9);
}

TEST(CompareSummary, KernelPeriodsFollowLinesAndChecks) {
  EXPECT_TRUE(kernel_periods(history(10, 10)).empty());
  const std::vector<KernelPeriod> late = kernel_periods(with_switch(history(10, 10), 2000));
  ASSERT_EQ(late.size(), 2u);
  EXPECT_EQ(late[0].kernel, "segmented");
  EXPECT_EQ(late[0].until, 1999) << "the check runs before the step of its iteration";
  EXPECT_EQ(late[1].from, 1999);
  EXPECT_EQ(late[1].until, 4000);
  const std::vector<KernelPeriod> early = kernel_periods(with_switch(history(10, 10), 1));
  ASSERT_EQ(early.size(), 1u);
  EXPECT_EQ(early[0].kernel, "sub-tile");
  EXPECT_EQ(early[0].from, 0);

  TrainHistory resumed = with_kernel(history(10, 10), "dynamic");  // with another kernel, without a check
  for (LogPoint& point : resumed.points) point.kernel = point.iteration > 1000 ? "naive" : "dynamic";
  EXPECT_EQ(kernel_periods(resumed).at(0).until, 1000);
}

TEST(CompareSummary, TheVerdictIsAboutTheFirstAdaptiveConfiguration) {
  const Json summary =
      summarize_comparison({trained("naive", {history(10, 10)}), trained("shared-memory", {history(9, 9)}),
                            trained("adaptive", {history(8, 8)})},
                           4000, 100);
  EXPECT_EQ(summary["baseline"], "naive");
  EXPECT_EQ(summary["ours"], "adaptive");
  ASSERT_EQ(summary["compared"].size(), 2u);
  EXPECT_NEAR(summary["compared"][0]["saved_overall"]["mean"], 0.1, 1e-9);
  EXPECT_TRUE(summary["machine_spread"].is_null());
}

TEST(CompareSummary, SeparatesTheGainOfLoadBalancing) {
  const Json summary = summarize_comparison(
      {trained("naive", {history(10, 10), history(10, 10)}), trained("sub-tile", {history(5, 5), history(5, 5)}),
       trained("segmented", {history(4, 4), history(3, 3)})},
      4000, 100);
  ASSERT_EQ(summary["balancing"].size(), 1u) << "only for the balanced configuration";
  const Json& gain = summary["balancing"][0];
  EXPECT_EQ(gain["name"], "segmented");
  EXPECT_EQ(gain["unbalanced"], "sub-tile");
  EXPECT_NEAR(gain["saved_by_balancing"]["mean"], 0.3, 1e-9);
  EXPECT_NEAR(gain["saved_by_balancing"]["min"], 0.2, 1e-9);
  EXPECT_NEAR(gain["saved_by_balancing"]["max"], 0.4, 1e-9);
}

TEST(CompareSummary, TheGainIsAgainstUnbalancedKernelsOfTheSameFamily) {
  const Json both =
      summarize_comparison({trained("naive", {history(10, 10)}), trained("shared-memory", {history(8, 8)}),
                            trained("sub-tile", {history(4, 4)}), trained("adaptive", {history(2, 2)}),
                            trained("published", {history(7, 7)}), trained("combined", {history(6, 6)})},
                           4000, 100)["balancing"];
  ASSERT_EQ(both.size(), 3u);
  EXPECT_EQ(both[0]["unbalanced"], "sub-tile") << "adaptive";
  EXPECT_EQ(both[1]["unbalanced"], "shared-memory") << "published";
  EXPECT_EQ(both[2]["unbalanced"], "shared-memory") << "combined";
  EXPECT_NEAR(both[2]["saved_by_balancing"]["mean"], 0.25, 1e-9);

  const auto is_known = [](const char* kernel, const char* unbalanced) {
    return !summarize_comparison({trained("naive", {history(1, 1)}), trained(unbalanced, {history(1, 1)}),
                                  trained(kernel, {history(1, 1)})},
                                 4000, 100)["balancing"]
                .empty();
  };
  for (const char* ours : {"adaptive", "segmented"}) EXPECT_FALSE(is_known(ours, "shared-memory")) << ours;
  for (const char* of_paper : {"published", "combined", "dynamic", "gaussian-wise"}) {
    EXPECT_TRUE(is_known(of_paper, "shared-memory")) << of_paper;
    EXPECT_FALSE(is_known(of_paper, "sub-tile")) << of_paper;
  }
}

TEST(CompareSummary, KnowsWhichKernelsAreBalanced) {
  for (const char* name : {"naive", "shared-memory", "sub-tile", "no kernel"}) {
    EXPECT_FALSE(is_balanced_kernel(name)) << name;
  }
  for (const char* name : {"dynamic", "gaussian-wise", "combined", "segmented"}) {
    EXPECT_TRUE(is_balanced_kernel(name)) << name;
  }
}

TEST(CompareSummary, ARepeatedBaselineGivesTheRunToRunVariation) {
  const Json summary = summarize_comparison(
      {trained("naive", {with_quality(history(10, 10), 25, 1000), with_quality(history(10, 10), 26, 1000)}),
       trained("ours", {with_quality(with_switch(history(8, 9.5), 2001), 25.3, 1000),
                        with_quality(with_switch(history(8, 9.5), 2001), 26, 1000)}),
       {"again",
        config_with("naive"),
        {with_quality(history(10.1, 10), 25.2, 1000), with_quality(history(10, 9.6), 25.9, 1010)}}},
      4000, 100);
  EXPECT_EQ(summary["repetition"], "again");
  EXPECT_NEAR(summary["machine_spread"], 0.02, 1e-9) << "the larger of 0.5 and 2 %";
  const Json& ours = summary["compared"][0];
  EXPECT_NEAR(ours["saved_overall"]["mean"], 0.125, 1e-9);
}

TEST(CompareSummary, RunToRunVariationLimitsEveryFinding) {
  // Two runs of naive differ by 1.5 dB and 5 %, so differences of 2 dB and 20 % may be chance.
  const auto summary = [](int iterations_of_ours) {
    std::vector<ConfigurationHistory> all{trained("naive", {with_quality(history(10, 10), 25, 1000)}),
                                          trained("naive", {with_quality(history(8, 8, iterations_of_ours), 27, 1000)}),
                                          trained("naive", {with_quality(history(9.5, 9.5), 26.5, 1000)})};
    for (ConfigurationHistory& own : all) own.config.iterations = 4000;
    all[1].config.iterations = iterations_of_ours;
    all[1].config.feature_lr *= 2;
    all[1].name = "ours";
    all[2].name = "naive_again";
    return summarize_comparison(all, 4000, 100);
  };
  const Json same = summary(4000), shorter = summary(2000);
  for (const std::size_t i : {0, 1}) {
    EXPECT_EQ(same["compared"][i]["saved_overall"]["finding"], "unclear");
    EXPECT_EQ(same["compared"][i]["quality"][0]["finding"], "unclear");
    for (const Json& own : {same, shorter}) {
      EXPECT_EQ(own["results"][i + 1]["psnr_gained"]["finding"], "unclear");
      EXPECT_NEAR(own["results"][i + 1]["psnr_gained"]["limit"], 12.706 * 1.5, 1e-9);
    }
  }
  EXPECT_NE(shorter["verdict"].get<std::string>().find("less than 19.1 dB may be chance, judging by two runs of naive"),
            std::string::npos)
      << shorter["verdict"];
}

TEST(CompareSummary, OnlyTheSameComparisonIsSetBesideThePaper) {
  const auto original = [](const std::string& kernel) {
    ConfigurationHistory own = trained(kernel, {with_switch(history(8, 9.5), 2001)});
    own.name = "original_" + kernel;
    own.config.culling = Culling::kSquare;
    return own;
  };
  ConfigurationHistory often = original("published");
  often.name = "often";
  often.config.kernel_check_interval = 200;
  const Json pairs = summarize_comparison(
      {trained("sub-tile", {history(10, 10)}), trained("published", {history(9, 9)}), original("naive"),
       original("adaptive"), original("published"), original("combined"), often},
      4000, 100)["beside_paper"];
  ASSERT_EQ(pairs.size(), 2u) << "not with another culling, another baseline or a fixed kernel";
  EXPECT_EQ(pairs[0]["baseline"], "original_naive");
  EXPECT_EQ(pairs[0]["name"], "original_published");
  EXPECT_FALSE(pairs[0]["saved_before_inflection"].is_null());
  EXPECT_EQ(pairs[1]["name"], "often") << "the interval belongs to the choice of the kernel";
}

TEST(CompareSummary, QualityIsComparedSeedBySeed) {
  const auto quality = [](std::vector<double> naive, std::vector<double> ours) {
    std::vector<TrainHistory> a, b;
    for (const double psnr : naive) a.push_back(with_quality(history(10, 10), psnr, 1000));
    for (const double psnr : ours) b.push_back(with_quality(history(8, 8), psnr, 1100));
    return summarize_pair(a, b)["compared"][0]["quality"];
  };
  const Json paired = quality({25, 26, 27}, {24.7, 25.68, 26.72});
  ASSERT_EQ(paired.size(), 3u);
  EXPECT_EQ(paired[0]["finding"], "differs") << "each seed lost 0.3 dB, though seeds differ by 2 dB";
  EXPECT_NEAR(paired[0]["difference"], -0.3, 1e-9);
  EXPECT_NEAR(paired[0]["interval"][1], -0.3 + 4.303 * 0.02 / std::sqrt(3), 1e-9);
  EXPECT_EQ(paired[0]["tolerance"], 0.1);
  EXPECT_EQ(paired[1]["finding"], "equal");
  EXPECT_EQ(paired[2]["finding"], "differs") << "a tenth more Gaussians";
  EXPECT_EQ(quality({25, 25, 25}, {25.05, 25.06, 25.04})[0]["finding"], "equal") << "within 0.1 dB";
  EXPECT_EQ(quality({25, 25, 25}, {25.5, 24.6, 25.3})[0]["finding"], "unclear");
  EXPECT_EQ(quality({25, 25.5}, {25.3, 25.9})[0]["finding"], "unclear") << "two seeds tell little";
  EXPECT_TRUE(summarize_pair({history(10, 10)}, {history(8, 8)})["compared"][0]["quality"].empty())
      << "nothing measured";
}

TEST(CompareSummary, OneSeedSaysLittleOfQualityAndTime) {
  const auto compared = [](double psnr, double ms) {
    return summarize_pair({with_quality(history(10, 10), 25, 1000)},
                          {with_quality(history(ms, ms), psnr, 1000)})["compared"][0];
  };
  EXPECT_EQ(compared(25.01, 10)["quality"][0]["finding"], "unclear") << "not equal, either";
  EXPECT_EQ(compared(25.004, 10)["quality"][0]["finding"], "equal") << "to the digits that are shown";
  EXPECT_EQ(compared(24.5, 10)["quality"][0]["finding"], "unclear");
  EXPECT_EQ(compared(23.5, 10)["quality"][0]["finding"], "differs");
  EXPECT_EQ(compared(25, 9.5)["saved_overall"]["finding"], "unclear");
  EXPECT_EQ(compared(25, 8.5)["saved_overall"]["finding"], "differs");
  EXPECT_TRUE(compared(25, 8.5)["saved_overall"]["interval"].is_null());
}

TEST(CompareSummary, QualityIsComparedWhereAllWereMeasured) {
  const auto measured_at = [](TrainHistory history, std::vector<std::pair<int, double>> psnr) {
    for (const auto& [iteration, value] : psnr) {
      history.points.at(static_cast<std::size_t>(iteration / 10 - 1)).test_psnr = value;
    }
    return history;
  };
  const Json quality =
      summarize_pair({measured_at(history(10, 10), {{1000, 20}, {4000, 25}})},
                     {measured_at(history(8, 8, 3000), {{1000, 20.05}, {2000, 23}})})["compared"][0]["quality"];
  ASSERT_EQ(quality.size(), 1u);
  EXPECT_EQ(quality[0]["iteration"], 1000);
  EXPECT_EQ(quality[0]["baseline"]["mean"], 20);
  EXPECT_EQ(quality[0]["ours"]["mean"], 20.05);

  // A second seed that has not progressed as far is not counted, and does not change what is compared.
  const Json two = summarize_pair(
      {measured_at(history(10, 10), {{1000, 20}, {4000, 25}}), measured_at(history(10, 10, 2000), {{1000, 10}})},
      {measured_at(history(8, 8), {{1000, 20}, {4000, 25.2}}), measured_at(history(8, 8, 2000), {{1000, 10}})});
  const Json& last = two["compared"][0]["quality"].at(0);
  EXPECT_EQ(last["iteration"], 4000);
  EXPECT_EQ(last["baseline"]["n"], 1);
  EXPECT_EQ(last["ours"]["mean"], 25.2);
  EXPECT_EQ(last["tolerance"], 1) << "the range of one seed says nothing";
}

TEST(CompareSummary, BeforeAndAfterAreOfTheSameSeeds) {
  const TrainHistory naive = history(10, 10);
  const Json compared =
      summarize_pair({naive, naive, naive}, {with_switch(history(8, 9.5), 2001), with_switch(history(9, 9), 1),
                                             with_kernel(history(7, 7), "combined")})["compared"][0];
  EXPECT_EQ(compared["saved_before_inflection"]["n"], 1);
  EXPECT_EQ(compared["saved_after_inflection"]["n"], 1) << "the second seed has no time before its first step";
  EXPECT_NEAR(compared["saved_after_inflection"]["mean"], 0.05, 1e-9);
  EXPECT_EQ(compared["inflection"]["n"], 2);
  EXPECT_EQ(compared["saved_overall"]["n"], 3);
}

ConfigurationHistory of_length(const std::string& name, int iterations, std::vector<TrainHistory> by_seed) {
  TrainConfig config;
  config.iterations = iterations;
  config.feature_lr *= name == "fast" ? 2 : 1;
  return {name, config, std::move(by_seed)};
}

/// The times are 40 s and 8 s. The second seed of `fast` is not finished.
std::vector<ConfigurationHistory> of_two_lengths() {
  return {of_length("inria", 4000, {with_quality(history(1, 1), 28, 900000), with_quality(history(1, 1), 29, 1000000)}),
          of_length("fast", 1000,
                    {with_quality(history(0.8, 1, 1000), 28.75, 200000), with_quality(history(0.8, 1, 500), 20, 5)})};
}

TEST(FinalResults, AreThoseOfEachConfigurationsOwnEnd) {
  const Json results = summarize_comparison(of_two_lengths(), 4000, 100)["results"];
  ASSERT_EQ(results.size(), 2u);
  EXPECT_EQ(results[0]["complete_seeds"], 2);
  EXPECT_NEAR(results[0]["seconds"]["mean"], 4, 1e-9);
  EXPECT_EQ(results[0]["psnr"]["mean"], 28.5);
  EXPECT_EQ(results[0]["psnr"]["min"], 28);
  EXPECT_EQ(results[0]["gaussians"]["mean"], 950000);
  EXPECT_EQ(results[1]["iterations"], 1000);
  EXPECT_EQ(results[1]["complete_seeds"], 1) << "unfinished trainings do not count";
  EXPECT_NEAR(results[1]["seconds"]["mean"], 0.8, 1e-9);
  EXPECT_EQ(results[1]["psnr"]["mean"], 28.75);
  EXPECT_EQ(results[1]["psnr_gained"]["finding"], "unclear");
}

TEST(FinalResults, AreTheVerdictWhereLengthsDiffer) {
  const auto text = [](const std::vector<ConfigurationHistory>& all) {
    return summarize_comparison(all, 4000, 100)["verdict"].get<std::string>();
  };
  EXPECT_EQ(
      text(of_two_lengths()),
      "Not finished. So far: fast took 0.80 s for 1,000 iterations, and inria 4.00 s for 4,000; the PSNR of fast "
      "in 1 of 2 seeds shows no clear difference (+0.75 dB, one seed, less than 1 dB may be chance, assuming that "
      "runs vary by at most 0.2 dB).");
  std::vector<ConfigurationHistory> complete = of_two_lengths();
  complete[1].by_seed[1] = complete[1].by_seed[0];
  EXPECT_EQ(text(complete),
            "fast took 0.80 s for 1,000 iterations, and inria 4.00 s for 4,000; the PSNR of fast shows no clear "
            "difference (+0.25 dB, 95 % interval -6.10 to +6.60 dB).");
  EXPECT_EQ(text({of_length("inria", 4000, {history(1, 1)}), of_length("fast", 1000, {history(0.8, 1, 1000)})}),
            "fast took 0.80 s for 1,000 iterations, and inria 4.00 s for 4,000; quality was not measured, because no "
            "views were held out (--no_eval).");
  for (ConfigurationHistory& own : complete) own.by_seed = {TrainHistory{}, TrainHistory{}};
  EXPECT_EQ(text(complete), "No result yet: not every configuration has been trained.");
}

TEST(FinalResults, AreInTheTableWithTheirSeedsWhereLengthsDiffer) {
  std::vector<ConfigurationHistory> all = of_two_lengths();
  all.push_back(all[1]);
  all[2].name = "short";
  all[1].by_seed[1] = all[1].by_seed[0];
  EXPECT_EQ(aligned_text(results_table(summarize_comparison(all, 4000, 100))),
            "at the end of   seeds  iterations  training s  PSNR dB  difference      95 % interval  one-seed limit    "
            " PSNR    SSIM  Gaussians\n"
            "inria               -       4,000        4.00    28.50           -                  -               -    "
            "    -  0.9000    950,000\n"
            "fast                -       1,000        0.80    28.75    +0.25 dB  -6.10 to +6.60 dB               -  "
            "unclear  0.9000    200,000\n"
            "short          1 of 2       1,000        0.80    28.75    +0.75 dB                  -            1 dB  "
            "unclear  0.9000    200,000\n");
}

}  // namespace
}  // namespace b3dgs
