// What a comparison says, over invented curves.
#include "app/compare_summary.h"
#include "app/compare_verdict.h"

#include <gtest/gtest.h>

#include "app/compare_config.h"
#include "support/expect_error.h"

namespace b3dgs {
namespace {

/// Lines every 10 iterations: `early_ms` a step up to iteration 2000, `late_ms` after it. No kernel is named.
TrainHistory history(double early_ms, double late_ms, int until = 4000) {
  TrainHistory history;
  double elapsed_s = 0;
  for (int iteration = 10; iteration <= until; iteration += 10) {
    elapsed_s += 0.01 * (iteration <= 2000 ? early_ms : late_ms);
    LogPoint point;
    point.iteration = iteration;
    point.elapsed_s = elapsed_s;
    history.points.push_back(point);
  }
  return history;
}

/// As a training that never changed its kernel writes it.
TrainHistory with_kernel(TrainHistory history, const std::string& kernel) {
  for (LogPoint& point : history.points) point.kernel = kernel;
  return history;
}

/// As a training writes it that went over from combined to shared-memory before the step of `iteration`.
TrainHistory with_inflection(TrainHistory history, int iteration) {
  for (LogPoint& point : history.points) {
    point.kernel = point.iteration < iteration ? "combined" : "shared-memory";
  }
  KernelCheckEvent kept, changed;
  kept.iteration = iteration - 1000;
  kept.pass = changed.pass = "forward";
  kept.before = kept.after = changed.before = "combined";
  changed.iteration = iteration;
  changed.after = "shared-memory";
  history.checks = {changed};
  if (kept.iteration > 0) history.checks.insert(history.checks.begin(), kept);
  return history;
}

TrainHistory with_quality(TrainHistory history, double psnr, std::int64_t count) {
  history.points.back().test_psnr = psnr;
  history.points.back().test_ssim = 0.9;
  history.points.back().count = count;
  return history;
}

ComparisonSummary summarize_pair(std::vector<TrainHistory> naive, std::vector<TrainHistory> adaptive,
                                 const std::string& kernel = "adaptive") {
  return summarize_comparison({{"naive", "naive", std::move(naive)}, {"ours", kernel, std::move(adaptive)}}, 4000);
}

TEST(CompareSummary, InterpolatesElapsedTime) {
  const TrainHistory curve = history(10, 20);
  EXPECT_DOUBLE_EQ(elapsed_at(curve, 0), 0);
  EXPECT_NEAR(elapsed_at(curve, 5), 0.05, 1e-12);
  EXPECT_NEAR(elapsed_at(curve, 2000), 20, 1e-9);
  EXPECT_NEAR(elapsed_at(curve, 2005), 20.1, 1e-9);
  EXPECT_NEAR(elapsed_at(curve, 9999), 60, 1e-9) << "beyond the end it stays";
  EXPECT_EQ(elapsed_at(TrainHistory{}, 100), 0);
}

TEST(CompareSummary, TellsTheTimeSavedBeforeAndAfterTheInflection) {
  const auto saved = saved_time(history(10, 10), with_inflection(history(8, 9.5), 2001));
  ASSERT_TRUE(saved);
  EXPECT_EQ(saved->inflection, 2001);
  EXPECT_NEAR(saved->before.value(), 0.2, 1e-9);
  EXPECT_NEAR(saved->after.value(), 0.05, 1e-9);
  EXPECT_NEAR(saved->overall, 0.125, 1e-9);
  EXPECT_NEAR(saved->baseline_s, 40, 1e-9);
  EXPECT_NEAR(saved->ours_s, 35, 1e-9);
}

TEST(CompareSummary, WithoutAnInflectionThereIsNoBeforeAndAfter) {
  const auto saved = saved_time(history(10, 10), history(8, 8));
  ASSERT_TRUE(saved);
  EXPECT_FALSE(saved->inflection);
  EXPECT_FALSE(saved->before);
  EXPECT_FALSE(saved->after);
  EXPECT_NEAR(saved->overall, 0.2, 1e-9);
  EXPECT_FALSE(saved_time(history(10, 10), TrainHistory{}));

  const auto from_the_start = saved_time(history(10, 10), with_inflection(history(8, 8), 1));
  ASSERT_TRUE(from_the_start);
  EXPECT_FALSE(from_the_start->before) << "nothing lies before the first step";
  EXPECT_NEAR(from_the_start->after.value(), 0.2, 1e-3);

  TrainHistory backward = with_inflection(history(8, 8), 2000);
  for (KernelCheckEvent& check : backward.checks) check.pass = "backward";
  EXPECT_FALSE(inflection_point(backward));
  EXPECT_FALSE(inflection_point(TrainHistory{}));
}

TEST(CompareSummary, UnequalLengthsAreComparedAsFarAsBothGo) {
  const auto saved = saved_time(history(10, 10, 3000), history(8, 8, 1000));
  ASSERT_TRUE(saved);
  EXPECT_EQ(saved->until, 1000);
  EXPECT_NEAR(saved->baseline_s, 10, 1e-9);
  const ComparisonSummary summary =
      summarize_pair({history(10, 10, 3000)}, {with_kernel(history(8, 8, 1000), "combined")});
  EXPECT_EQ(summary.done, 1000);
  EXPECT_EQ(verdict(summary),
            "Not finished: 1000 of 4000 iterations. So far: Balancing saved 20.0 % of the training time on this scene "
            "(ours 8.00 s, naive 10.00 s).");
}

TEST(CompareSummary, TheVerdictSaysWhetherItPaid) {
  const auto balanced = [](TrainHistory history) { return with_kernel(std::move(history), "combined"); };
  EXPECT_EQ(verdict(summarize_pair({history(10, 10)}, {balanced(history(8, 9.5))})),
            "Balancing saved 12.5 % of the training time on this scene (ours 35.0 s, naive 40.0 s).");
  EXPECT_EQ(verdict(summarize_pair({history(10, 10)}, {balanced(history(11, 11))})),
            "Balancing did not pay on this scene: it took 10.0 % longer (ours 44.0 s, naive 40.0 s).");
  EXPECT_EQ(verdict(summarize_pair({history(10, 10)}, {balanced(history(9.95, 9.95))})),
            "Balancing did not pay on this scene: it made no difference beyond 1 % (ours 39.8 s, naive 40.0 s).");
  EXPECT_EQ(verdict(summarize_pair({history(10, 10)}, {history(8, 8)}, "shared-memory")),
            "ours saved 20.0 % of the training time of naive (ours 32.0 s, naive 40.0 s).");
  EXPECT_NE(verdict(summarize_pair({history(10, 10), history(10, 10)}, {history(7, 7), history(11, 11)}))
                .find("the seeds disagree, from -10.0 % to 30.0 %"),
            std::string::npos);
  EXPECT_EQ(verdict(summarize_pair({history(10, 10)}, {TrainHistory{}})),
            "Nothing can be said yet: not every configuration has been trained.");
}

TEST(CompareSummary, BalancingIsNotCreditedWithWhatAnotherKernelSaved) {
  const auto from_the_start = [](double ms) { return with_inflection(history(ms, ms), 1); };
  EXPECT_EQ(
      verdict(summarize_pair({history(10, 10)}, {from_the_start(9)})),
      "Balancing did not pay on this scene: shared-memory was faster from the start; with it ours saved 10.0 % of "
      "the training time (ours 36.0 s, naive 40.0 s).");
  EXPECT_EQ(verdict(summarize_pair({history(10, 10)}, {from_the_start(11)})),
            "Balancing did not pay on this scene: shared-memory was faster from the start; with it ours took 10.0 % "
            "longer (ours 44.0 s, naive 40.0 s).");
  TrainHistory refused = from_the_start(9);
  for (KernelCheckEvent& check : refused.checks) check.refused = {"combined"};
  EXPECT_EQ(
      verdict(summarize_pair({history(10, 10)}, {refused})),
      "Balancing did not pay on this scene: no balanced kernel was in use; with shared-memory ours saved 10.0 % of "
      "the training time (ours 36.0 s, naive 40.0 s).");
  EXPECT_EQ(verdict(summarize_pair({history(10, 10)}, {history(9, 9)})),
            "ours saved 10.0 % of the training time of naive (ours 36.0 s, naive 40.0 s).")
      << "which kernel ran is not known";
}

TEST(CompareSummary, WhereABalancedKernelRanForAPartTheVerdictTellsTheParts) {
  EXPECT_EQ(verdict(summarize_pair({history(10, 10)}, {with_inflection(history(8, 9.5), 2001)})),
            "Balancing saved 20.0 % in the 2000 of 4000 iterations that combined did; shared-memory saved 5.0 % in the "
            "others; overall ours saved 12.5 % of the training time (ours 35.0 s, naive 40.0 s).");
  EXPECT_EQ(
      verdict(summarize_pair({history(10, 10)}, {with_inflection(history(10.5, 8), 2001)})),
      "Balancing did not pay on this scene: it took 5.0 % longer in the 2000 of 4000 iterations that combined did; "
      "shared-memory saved 20.0 % in the others; overall ours saved 7.5 % of the training time (ours 37.0 s, "
      "naive 40.0 s).");
  const std::string one_seed = verdict(summarize_pair(
      {history(10, 10), history(10, 10)}, {with_inflection(history(8, 9.5), 2001), with_inflection(history(9, 9), 1)}));
  EXPECT_NE(one_seed.find("that combined did in 1 of 2 seeds; shared-memory saved"), std::string::npos) << one_seed;
}

TEST(CompareSummary, KernelPeriodsFollowLinesAndChecks) {
  EXPECT_TRUE(kernel_periods(history(10, 10)).empty());
  const std::vector<KernelPeriod> late = kernel_periods(with_inflection(history(10, 10), 2000));
  ASSERT_EQ(late.size(), 2u);
  EXPECT_EQ(late[0].kernel, "combined");
  EXPECT_EQ(late[0].until, 1999) << "the check comes before the step of its iteration";
  EXPECT_EQ(late[1].from, 1999);
  EXPECT_EQ(late[1].until, 4000);
  const std::vector<KernelPeriod> early = kernel_periods(with_inflection(history(10, 10), 1));
  ASSERT_EQ(early.size(), 1u);
  EXPECT_EQ(early[0].kernel, "shared-memory");
  EXPECT_EQ(early[0].from, 0);

  TrainHistory resumed = with_kernel(history(10, 10), "dynamic");  // with another kernel, without a check
  for (LogPoint& point : resumed.points) point.kernel = point.iteration > 1000 ? "naive" : "dynamic";
  EXPECT_EQ(kernel_periods(resumed).at(0).until, 1000);
}

TEST(CompareSummary, TheVerdictIsAboutTheAdaptiveConfigurationIfThereIsOne) {
  const ComparisonSummary summary = summarize_comparison({{"naive", "naive", {history(10, 10)}},
                                                          {"shared-memory", "shared-memory", {history(9, 9)}},
                                                          {"adaptive", "adaptive", {history(8, 8)}}},
                                                         4000);
  EXPECT_EQ(summary.baseline, "naive");
  EXPECT_EQ(summary.ours, "adaptive");
  EXPECT_EQ(summary.compared.size(), 2u);
  EXPECT_NEAR(summary.find("shared-memory")->overall->mean, 0.1, 1e-9);
  EXPECT_EQ(summary.find("nobody"), nullptr);
}

TEST(CompareSummary, QualityIsEqualWithinTheSpreadOfTheSeeds) {
  const auto quality = [](std::vector<double> naive, std::vector<double> ours) {
    std::vector<TrainHistory> a, b;
    for (const double psnr : naive) a.push_back(with_quality(history(10, 10), psnr, 1000));
    for (const double psnr : ours) b.push_back(with_quality(history(8, 8), psnr, 1100));
    return summarize_pair(a, b).compared[0].quality;
  };
  const std::vector<QualityDifference> one = quality({25}, {25.05});
  ASSERT_EQ(one.size(), 3u);
  EXPECT_TRUE(one[0].is_equal());
  EXPECT_TRUE(one[1].is_equal());
  EXPECT_FALSE(one[2].is_equal()) << "a tenth more Gaussians";
  EXPECT_FALSE(quality({25}, {24.8})[0].is_equal());
  EXPECT_TRUE(quality({25.0, 25.5}, {25.3, 25.9})[0].is_equal()) << "0.35 dB apart, ranges of 0.5 and 0.6";
  EXPECT_FALSE(quality({25.0, 25.1}, {25.3, 25.4})[0].is_equal());
  EXPECT_TRUE(summarize_pair({history(10, 10)}, {history(8, 8)}).compared[0].quality.empty()) << "nothing measured";
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
  EXPECT_EQ(last.tolerance, 0.1) << "the range of one seed says nothing";
  EXPECT_NE(quality_criterion(two).find("PSNR, dB 0.1; SSIM 0.003; Gaussians 2 %"), std::string::npos)
      << quality_criterion(two);
}

TEST(CompareSummary, SeedsThatHaveNotBegunDoNotCount) {
  const auto combined = [](int until) { return with_kernel(history(8, 8, until), "combined"); };
  const ComparisonSummary summary = summarize_pair({history(10, 10), history(10, 10, 500), TrainHistory{}},
                                                   {combined(4000), TrainHistory{}, TrainHistory{}});
  EXPECT_EQ(summary.done, 4000);
  EXPECT_EQ(summary.done_by_seed, (std::vector<int>{4000, 0, 0}));
  EXPECT_EQ(summary.seeds_begun(), 1);
  EXPECT_EQ(summary.compared[0].overall->n, 1);
  EXPECT_EQ(
      verdict(summary),
      "Not finished: 4000 of 4000 iterations in 1 of 3 seeds. So far: Balancing saved 20.0 % of the training time "
      "on this scene (ours 32.0 s, naive 40.0 s).");
  EXPECT_EQ(summarize_pair({TrainHistory{}}, {TrainHistory{}}).done, 0);
}

TEST(CompareSummary, BeforeAndAfterAreOfTheSameSeeds) {
  const TrainHistory naive = history(10, 10);
  const ComparedConfiguration compared =
      summarize_pair({naive, naive, naive}, {with_inflection(history(8, 9.5), 2001), with_inflection(history(9, 9), 1),
                                             with_kernel(history(7, 7), "combined")})
          .compared[0];
  ASSERT_TRUE(compared.before && compared.after);
  EXPECT_EQ(compared.before->n, 1);
  EXPECT_EQ(compared.after->n, 1) << "the second seed has an after, but no before";
  EXPECT_NEAR(compared.after->mean, 0.05, 1e-9);
  EXPECT_EQ(compared.inflection->n, 2);
  EXPECT_EQ(compared.overall->n, 3);
  EXPECT_EQ(in_seeds(compared.before->n, compared.overall->n), " in 1 of 3 seeds");
  EXPECT_EQ(in_seeds(3, 3), "");
}

TEST(CompareSummary, IsWrittenAsJson) {
  const auto json = to_json(summarize_pair({history(10, 10)}, {with_inflection(history(8, 9.5), 2001)}));
  EXPECT_EQ(json["compared"][0]["inflection"]["mean"], 2001);
  EXPECT_EQ(json["compared"][0]["balanced_kernels"]["names"], nlohmann::ordered_json::array({"combined"}));
  EXPECT_EQ(json["compared"][0]["balanced_kernels"]["iterations"]["mean"], 2000);
  EXPECT_NEAR(json["compared"][0]["other_kernels"]["saved"]["mean"].get<double>(), 0.05, 1e-9);
  EXPECT_NEAR(json["compared"][0]["saved_before_inflection"]["mean"].get<double>(), 0.2, 1e-9);
  EXPECT_EQ(json["compared"][0]["saved_overall"]["n"], 1);
  EXPECT_TRUE(to_json(summarize_pair({history(10, 10)}, {history(8, 8)}))["compared"][0]["inflection"].is_null());
}

TEST(CompareConfig, AnEntryIsAKernelOrOptions) {
  TrainConfig base;
  base.iterations = 123;
  const auto entries =
      parse_configurations("naive,shared-memory+culling=square,mine:opacity-lr=0.5+random_background=true", base);
  ASSERT_EQ(entries.size(), 3u);
  EXPECT_EQ(entries[0].name, "naive");
  EXPECT_EQ(entries[0].config.kernel, "naive");
  EXPECT_EQ(entries[0].config.iterations, 123);
  EXPECT_EQ(entries[1].name, "shared-memory+culling=square");
  EXPECT_EQ(entries[1].config.kernel, "shared-memory");
  EXPECT_EQ(entries[1].config.culling, "square");
  EXPECT_EQ(entries[2].name, "mine");
  EXPECT_EQ(entries[2].config.opacity_lr, 0.5);
  EXPECT_TRUE(entries[2].config.random_background);
  EXPECT_EQ(entries[2].config.kernel, base.kernel);
  const auto paper = parse_configurations("naive,paper:kernel_candidates=combined/shared-memory", base);
  EXPECT_EQ(paper[1].config.kernel_candidates, (std::vector<std::string>{"combined", "shared-memory"}))
      << "commas separate configurations";
  EXPECT_EQ(parse_configurations("a:naive,b:naive", base).size(), 2u) << "one against itself measures the noise";
}

TEST(CompareConfig, BadEntriesAreRefusedWithAReason) {
  const auto expect_refused = [](const std::string& text, const std::string& reason) {
    EXPECT_TRUE(test::fails_with<InputError>({reason}, [&] { parse_configurations(text, TrainConfig{}); })) << text;
  };
  expect_refused("naive,naiv", "kernel must be one of naive");
  expect_refused("naive", "takes at least two");
  expect_refused("naive,naive", "occurs twice");
  expect_refused("naive,", "an empty part");
  expect_refused("naive,combined+", "an empty part");
  expect_refused("naive,combined+culing=square", "did you mean culling?");
  expect_refused("naive,combined+tile_width=8", "did you mean tile?");
  expect_refused("naive,combined+culling=round", "culling must be one of");
  expect_refused("naive,combined+seed=3", "has to be the same for all");
  expect_refused("naive,combined+max_steps=3", "has to be the same for all");
  expect_refused("naive,init_ply=/tmp/x.ply", "cannot name a folder");
  expect_refused("naive,../x:combined",
                 "cannot name a folder; give it a name of letters, digits, _ - . + = instead: "
                 "NAME:combined");
  expect_refused("a:naive,a:combined", "a occurs twice; give one another name: NAME:combined");
  expect_refused("naive,combined+seeed=3", "b3dgs train --help lists them");
}

}  // namespace
}  // namespace b3dgs
