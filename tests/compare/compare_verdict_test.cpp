// What a comparison says in a sentence, over invented curves.
#include "compare/compare_verdict.h"

#include <gtest/gtest.h>

#include "compare/invented_histories.h"

namespace b3dgs {
namespace {

using namespace test;

/// naive with 10 ms a step, shared-memory with 5, and ours as adaptive.
ComparisonSummary three(const TrainHistory& ours) {
  return summarize_comparison(
      {trained("naive", {history(10, 10)}), trained("shared-memory", {with_kernel(history(5, 5), "shared-memory")}),
       trained("adaptive", {ours})},
      4000);
}

TEST(Verdict, BalancingIsCreditedWithTheStepFromTheBestUnbalancedKernelAlone) {
  EXPECT_EQ(verdict(three(with_kernel(history(4, 4), "segmented"))),
            "Balancing saved 20.0 % of the training time of shared-memory, the best unbalanced kernel; shared-memory "
            "saved 50.0 % of the training time of naive; both together: 60.0 % (adaptive 16.0 s, shared-memory 20.0 s, "
            "naive 40.0 s).");
  EXPECT_EQ(verdict(three(with_kernel(history(5.5, 5.5), "segmented"))),
            "Balancing did not pay on this scene: adaptive took 10.0 % longer than shared-memory, the best unbalanced "
            "kernel; shared-memory saved 50.0 % of the training time of naive; both together: 45.0 % (adaptive 22.0 s, "
            "shared-memory 20.0 s, naive 40.0 s).");
  EXPECT_NE(verdict(three(with_kernel(history(4.98, 4.98), "segmented")))
                .find("adaptive made no difference beyond 1 % to shared-memory, the best unbalanced kernel"),
            std::string::npos);
}

TEST(Verdict, WhereNaiveIsTheBestUnbalancedKernelThereIsOneStep) {
  EXPECT_EQ(
      verdict(summarize_comparison({trained("naive", {history(10, 10)}), trained("shared-memory", {history(12, 12)}),
                                    trained("combined", {with_kernel(history(8, 8), "combined")})},
                                   4000)),
      "Balancing saved 20.0 % of the training time of naive, the best unbalanced kernel (combined 32.0 s, naive 40.0 "
      "s).")
      << "without an adaptive one it is about the balanced one";
}

TEST(Verdict, WhereABalancedKernelRanForAPartThatIsSaid) {
  EXPECT_EQ(verdict(three(with_inflection(history(4, 5), 2001))),
            "Balancing saved 10.0 % of the training time of shared-memory, the best unbalanced kernel, using combined "
            "in 2000 of 4000 iterations; shared-memory saved 50.0 % of the training time of naive; both together: "
            "55.0 % (adaptive 18.0 s, shared-memory 20.0 s, naive 40.0 s).");
}

TEST(Verdict, WithoutTheOtherUnbalancedKernelsBalancingIsNotCredited) {
  EXPECT_EQ(verdict(summarize_pair({history(10, 10)}, {with_kernel(history(8, 9.5), "combined")})),
            "ours saved 12.5 % of the training time of naive; how much of that is balancing is not known: "
            "shared-memory, not balanced either, was not trained (ours 35.0 s, naive 40.0 s).");
  EXPECT_EQ(verdict(summarize_pair({history(10, 10)}, {history(8, 8)}, "shared-memory")),
            "ours saved 20.0 % of the training time of naive (ours 32.0 s, naive 40.0 s).");
  EXPECT_EQ(verdict(summarize_pair({history(10, 10)}, {history(11, 11)}, "shared-memory")),
            "ours took 10.0 % longer than naive (ours 44.0 s, naive 40.0 s).");
  EXPECT_EQ(verdict(summarize_pair({history(10, 10)}, {TrainHistory{}})),
            "Nothing can be said yet: not every configuration has been trained.");
}

TEST(Verdict, OtherOptionsAreNamedAndBalancingIsNotCreditedWithThem) {
  ConfigurationHistory ours = trained("adaptive", {with_kernel(history(6, 6), "segmented")});
  ours.config.sh_degree = 0;
  ours.config.densify_until_iter = 0;
  const std::vector<ConfigurationHistory> configurations{trained("naive", {history(10, 10)}),
                                                         trained("shared-memory", {history(5, 5)}), ours};
  const ComparisonSummary summary = summarize_comparison(configurations, 4000);
  EXPECT_TRUE(summary.balancing.empty());
  EXPECT_EQ(verdict(summary),
            "The configuration adaptive saved 40.0 % of the training time of naive, from which it differs in the "
            "forward kernel, sh_degree and densify_until_iter (adaptive 24.0 s, naive 40.0 s).");
}

TEST(Verdict, AgainstAnotherConfigurationBothAreSaid) {
  ConfigurationHistory original = trained("naive", {history(20, 20)});
  original.name = "original";
  original.config.culling = "square";
  original.config.backward_kernel = "per-pixel";
  EXPECT_EQ(verdict(summarize_comparison(
                {original, trained("naive", {history(10, 10)}), trained("shared-memory", {history(5, 5)}),
                 trained("adaptive", {with_kernel(history(4, 4), "segmented")})},
                4000)),
            "Balancing saved 20.0 % of the training time of shared-memory, the best unbalanced kernel; shared-memory "
            "saved 50.0 % of the training time of naive; both together: 60.0 % (adaptive 16.0 s, shared-memory 20.0 s, "
            "naive 40.0 s). The configuration adaptive saved 80.0 % of the training time of original, from which it "
            "differs in the forward kernel, backward_kernel and culling (adaptive 16.0 s, original 80.0 s).");
}

TEST(Verdict, WhatAnotherKernelSavedIsNotBalancing) {
  const auto from_the_start = [](double ms) { return with_inflection(history(ms, ms), 1); };
  EXPECT_EQ(verdict(summarize_pair({history(10, 10)}, {from_the_start(9)})),
            "Balancing did not pay on this scene: shared-memory was faster from the start; with it ours saved 10.0 % "
            "of the training time of naive (ours 36.0 s, naive 40.0 s).");
  EXPECT_EQ(verdict(summarize_pair({history(10, 10)}, {from_the_start(11)})),
            "Balancing did not pay on this scene: shared-memory was faster from the start; with it ours took 10.0 % "
            "longer than naive (ours 44.0 s, naive 40.0 s).");
  EXPECT_EQ(verdict(three(from_the_start(5.1))),
            "Balancing did not pay on this scene: shared-memory was faster from the start; with it adaptive saved "
            "49.0 % of the training time of naive (adaptive 20.4 s, shared-memory 20.0 s, naive 40.0 s).");
  TrainHistory refused = from_the_start(9);
  for (KernelCheckEvent& check : refused.checks) check.refused = {"combined"};
  EXPECT_EQ(verdict(summarize_pair({history(10, 10)}, {refused})),
            "Balancing did not pay on this scene: no balanced kernel was in use; with shared-memory ours saved 10.0 % "
            "of the training time of naive (ours 36.0 s, naive 40.0 s).");
  EXPECT_EQ(verdict(three(history(4, 4))).find("adaptive saved 60.0 % of the training time of naive"), 0u)
      << "which kernel ran is not known";
}

TEST(Verdict, WhatTheMachineMakesOfOneAndTheSameIsNoDifference) {
  const auto summary = [](double again_ms) {
    ConfigurationHistory again = trained("naive", {history(again_ms, again_ms)});
    again.name = "naive_again";
    return summarize_comparison({trained("naive", {history(10, 10)}), trained("shared-memory", {history(5, 5)}),
                                 trained("adaptive", {with_kernel(history(4.9, 4.9), "segmented")}), again},
                                4000);
  };
  EXPECT_EQ(verdict(summary(10.01)),
            "Balancing saved 2.0 % of the training time of shared-memory, the best unbalanced kernel; shared-memory "
            "saved 50.0 % of the training time of naive; both together: 51.0 % (adaptive 19.6 s, shared-memory 20.0 s, "
            "naive 40.0 s); naive differs from itself by 0.1 %.");
  const std::string noisy = verdict(summary(9.7));
  EXPECT_EQ(
      noisy.find("Balancing did not pay on this scene: adaptive made no difference beyond 3.0 % to shared-memory"), 0u)
      << noisy;
  EXPECT_NE(noisy.find("naive differs from itself by 3.0 %"), std::string::npos);
  EXPECT_EQ(describe(summary(9.7).balancing[0], summary(9.7).noise()),
            "naive to shared-memory 50.0 % +-3.0 %, shared-memory to adaptive (balancing) 2.0 % +-3.0 %, naive to "
            "adaptive 51.0 % +-3.0 %");
}

TEST(Verdict, SaysWhereSeedsDisagreeOrAreMissing) {
  const auto combined = [](TrainHistory history) { return with_kernel(std::move(history), "combined"); };
  EXPECT_NE(
      verdict(summarize_pair({history(10, 10), history(10, 10)}, {combined(history(7, 7)), combined(history(11, 11))}))
          .find("the seeds disagree, from -10.0 % to 30.0 %"),
      std::string::npos);
  EXPECT_EQ(verdict(summarize_pair({history(10, 10, 3000)}, {history(8, 8, 1000)}, "shared-memory")),
            "Not finished: 1000 of 4000 iterations. So far: ours saved 20.0 % of the training time of naive (ours "
            "8.00 s, naive 10.00 s).");
  const ComparisonSummary one_of_three =
      summarize_pair({history(10, 10), history(10, 10, 500), TrainHistory{}},
                     {history(8, 8), TrainHistory{}, TrainHistory{}}, "shared-memory");
  EXPECT_EQ(one_of_three.done, 4000);
  EXPECT_EQ(one_of_three.done_by_seed, (std::vector<int>{4000, 0, 0}));
  EXPECT_EQ(one_of_three.seeds_begun(), 1);
  EXPECT_EQ(one_of_three.compared[0].overall->n, 1);
  EXPECT_EQ(verdict(one_of_three),
            "Not finished: 4000 of 4000 iterations in 1 of 3 seeds. So far: ours saved 20.0 % of the training time of "
            "naive (ours 32.0 s, naive 40.0 s).");
  EXPECT_EQ(summarize_pair({TrainHistory{}}, {TrainHistory{}}).done, 0);
}

}  // namespace
}  // namespace b3dgs
