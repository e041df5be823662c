// The headline of a comparison, for synthetic histories.
#include "compare/compare_verdict.h"

#include <gtest/gtest.h>

#include "compare/synthetic_histories.h"

namespace b3dgs {
namespace {

using namespace test;

/// naive with 10 ms per step, shared-memory with 5, and `ours` as adaptive.
ComparisonSummary three(const TrainHistory& ours) {
  return summarize_comparison(
      {trained("naive", {history(10, 10)}), trained("shared-memory", {with_kernel(history(5, 5), "shared-memory")}),
       trained("adaptive", {ours})},
      4000);
}

TEST(Verdict, LoadBalancingIsComparedWithTheFastestUnbalancedKernel) {
  EXPECT_EQ(verdict(three(with_kernel(history(4, 4), "segmented"))),
            "Load balancing saved 20.0 % of the training time of shared-memory, the fastest kernel without load "
            "balancing; shared-memory "
            "saved 50.0 % of the training time of naive; in total adaptive saved 60.0 % of the training time of naive "
            "(adaptive 16.0 s, shared-memory 20.0 s, "
            "naive 40.0 s).");
  EXPECT_EQ(verdict(three(with_kernel(history(6, 6), "segmented"))),
            "Load balancing saved no time on this scene: adaptive took 20.0 % longer than shared-memory, the fastest "
            "kernel without load balancing; shared-memory saved 50.0 % of the training time of naive; in total "
            "adaptive saved 40.0 % of the training time of naive (adaptive 24.0 s, "
            "shared-memory 20.0 s, naive 40.0 s).");
  EXPECT_EQ(verdict(three(with_kernel(history(4.8, 4.8), "segmented")))
                .find("Whether load balancing saves time is not clear: adaptive shows no clear difference in training "
                      "time from shared-memory, the fastest kernel without load balancing (time saved: 4.0 %; with one "
                      "seed, less than 10.0 % may be noise); shared-memory saved 50.0 %"),
            0u)
      << verdict(three(with_kernel(history(4.8, 4.8), "segmented")));
}

TEST(Verdict, SeveralSeedsTellSmallDifferencesFromChance) {
  const auto trained_for = [](const std::string& kernel, std::vector<double> ms) {
    std::vector<TrainHistory> runs;
    for (const double own : ms) runs.push_back(with_kernel(history(own, own), kernel));
    return trained(kernel, runs);
  };
  const auto text = [&](std::vector<double> ms) {
    return verdict(summarize_comparison(
        {trained_for("naive", {10, 10, 10}), trained_for("shared-memory", {5, 5, 5}), trained_for("segmented", ms)},
        4000));
  };
  EXPECT_EQ(text({4.8, 4.79, 4.81})
                .find("Load balancing saved 4.0 % (95 % interval 3.5 to 4.5 %) of the training time "
                      "of shared-memory, the fastest"),
            0u)
      << text({4.8, 4.79, 4.81});
  EXPECT_EQ(text({5.2, 5.19, 5.21})
                .find("Load balancing saved no time on this scene: segmented took 4.0 % (95 % "
                      "interval 3.5 to 4.5 %) longer than shared-memory, the fastest"),
            0u)
      << text({5.2, 5.19, 5.21});
  EXPECT_EQ(text({4.99, 5, 5})
                .find("Load balancing saved no time on this scene: segmented took as long as "
                      "shared-memory, the fastest kernel without load balancing (within 1 %)"),
            0u)
      << text({4.99, 5, 5});
  EXPECT_EQ(text({4.6, 5, 5.1})
                .find("Whether load balancing saves time is not clear: segmented shows no clear "
                      "difference in training time from shared-memory, the fastest kernel without load "
                      "balancing (time saved: 2.0 %, 95 % interval -11.1 to 15.1 %)"),
            0u)
      << text({4.6, 5, 5.1});
}

TEST(Verdict, NamesNaiveOnceIfItIsTheFastestUnbalancedKernel) {
  EXPECT_EQ(
      verdict(summarize_comparison({trained("naive", {history(10, 10)}), trained("shared-memory", {history(12, 12)}),
                                    trained("combined", {with_kernel(history(8, 8), "combined")})},
                                   4000)),
      "Load balancing saved 20.0 % of the training time of naive, the fastest kernel without load balancing (combined "
      "32.0 s, naive 40.0 "
      "s).")
      << "without an adaptive configuration, the verdict is about the balanced one";
}

TEST(Verdict, SaysForHowManyIterationsABalancedKernelWasUsed) {
  EXPECT_EQ(verdict(three(with_switch(history(3, 5), 2001))),
            "Load balancing saved 20.0 % of the training time of shared-memory, the fastest kernel without load "
            "balancing, using combined "
            "in 2000 of 4000 iterations; shared-memory saved 50.0 % of the training time of naive; in total adaptive "
            "saved 60.0 % of the training time of naive (adaptive 16.0 s, shared-memory 20.0 s, naive 40.0 s).");
}

TEST(Verdict, WithoutAllUnbalancedKernelsTheShareOfLoadBalancingIsUnknown) {
  EXPECT_EQ(verdict(summarize_pair({history(10, 10)}, {with_kernel(history(8, 9.5), "combined")})),
            "ours saved 12.5 % of the training time of naive; the share of load balancing is unknown because "
            "shared-memory, a kernel without load balancing, was not trained (ours 35.0 s, naive 40.0 s).");
  EXPECT_EQ(verdict(summarize_pair({history(10, 10)}, {history(8, 8)}, "shared-memory")),
            "ours saved 20.0 % of the training time of naive (ours 32.0 s, naive 40.0 s).");
  EXPECT_EQ(verdict(summarize_pair({history(10, 10)}, {history(12, 12)}, "shared-memory")),
            "ours took 20.0 % longer than naive (ours 48.0 s, naive 40.0 s).");
  EXPECT_EQ(verdict(summarize_pair({history(10, 10)}, {TrainHistory{}})),
            "No result yet: not every configuration has been trained.");
}

TEST(Verdict, NamesOtherOptionsInsteadOfLoadBalancing) {
  ConfigurationHistory ours = trained("adaptive", {with_kernel(history(6, 6), "segmented")});
  ours.config.sh_degree = 0;
  ours.config.densify_until_iter = 0;
  const std::vector<ConfigurationHistory> configurations{trained("naive", {history(10, 10)}),
                                                         trained("shared-memory", {history(5, 5)}), ours};
  const ComparisonSummary summary = summarize_comparison(configurations, 4000);
  EXPECT_TRUE(summary.balancing.empty());
  EXPECT_EQ(verdict(summary),
            "The configuration adaptive saved 40.0 % of the training time of naive, from which it differs in the "
            "forward kernel, sh_degree and densify_until_iter (adaptive 24.0 s, naive 40.0 s). No views were held out "
            "(--no_eval), so quality was not measured.");
}

TEST(Verdict, NamesTheFirstOfManyOtherOptions) {
  ConfigurationHistory ours = trained("naive", {history(5, 5)});
  ours.name = "fast";
  ours.config.preset = "fast";
  ours.config.feature_lr *= 2;
  ours.config.opacity_lr *= 2;
  ours.config.scaling_lr *= 2;
  ours.config.rotation_lr *= 2;
  ours.config.sh_degree = 0;
  ours.config.densify_from_iter = 0;
  EXPECT_EQ(verdict(summarize_comparison({trained("naive", {history(10, 10)}), ours}, 4000)),
            "The configuration fast saved 50.0 % of the training time of naive, from which it differs in sh_degree, "
            "preset, feature_lr, opacity_lr, scaling_lr and 2 more options (fast 20.0 s, naive 40.0 s). No views were "
            "held out (--no_eval), so quality was not measured.");
}

/// A configuration that learns with another rate.
ConfigurationHistory with_other_rate(const std::string& name, std::vector<TrainHistory> by_seed) {
  ConfigurationHistory own = trained("naive", std::move(by_seed));
  own.name = name;
  own.config.feature_lr *= 2;
  return own;
}

std::string last_sentence(const std::string& text, const std::string& beginning) {
  const std::size_t at = text.find(beginning);
  return at == std::string::npos ? text : text.substr(at);
}

TEST(Verdict, NamesThePsnrOfConfigurationsThatLearnDifferently) {
  const auto measured = [](double psnr, double ms = 5) { return with_quality(history(ms, ms), psnr, 1000); };
  std::vector<ConfigurationHistory> all{
      trained("naive", {measured(28.3)}), with_other_rate("fast", {measured(26.1, 4)}),
      with_other_rate("fine", {measured(29.5)}), with_other_rate("same", {measured(28.35)})};
  for (ConfigurationHistory& own : all) own.config.eval = true;
  EXPECT_EQ(verdict(summarize_comparison(all, 4000)),
            "The configuration fast reached 2.20 dB less than naive and saved 20.0 % of the training time of naive, "
            "from which it differs in feature_lr (fast 16.0 s, naive 20.0 s). PSNR of the held-out views: naive 28.30 "
            "dB, fast 26.10 dB (-2.20 dB), fine 29.50 dB (+1.20 dB), same 28.35 dB (+0.05 dB, may be chance). One "
            "seed: differences below 1 dB say nothing.");
  std::vector<ConfigurationHistory> seeds{
      trained("naive", {measured(28), measured(29), measured(28.5)}),
      with_other_rate("fast", {measured(27.5, 6), measured(28.48, 6), measured(28.02, 6)}),
      with_other_rate("same", {measured(28.01), measured(29), measured(28.5)}),
      with_other_rate("odd", {measured(28.5), measured(28.6), measured(28.41)})};
  EXPECT_EQ(last_sentence(verdict(summarize_comparison(seeds, 4000)), "The configuration"),
            "The configuration fast reached 0.50 dB less than naive and took 20.0 % (95 % interval 20.0 to 20.0 %) "
            "longer than naive, from which it differs in feature_lr (fast 24.0 s, naive 20.0 s). PSNR of the held-out "
            "views: naive 28.50 dB, fast 28.00 dB (-0.50 dB, 95 % interval -0.55 to -0.45), same 28.50 dB (equal "
            "within 0.1 dB), odd 28.50 dB (+0.00 dB, may be chance, 95 % interval -1.13 to +1.14).");
  for (ConfigurationHistory& own : all) own.by_seed = {with_quality(history(5, 5, 1000), 20, 10)};
  EXPECT_EQ(last_sentence(verdict(summarize_comparison(all, 4000)), "PSNR"),
            "PSNR of the held-out views after 1000 iterations: naive 20.00 dB, fast 20.00 dB (+0.00 dB, may be "
            "chance), fine 20.00 dB (+0.00 dB, may be chance), same 20.00 dB (+0.00 dB, may be chance). One seed: "
            "differences below 1 dB say nothing.");
  for (ConfigurationHistory& own : all) own.by_seed = {history(5, 5, 1000)};
  EXPECT_EQ(last_sentence(verdict(summarize_comparison(all, 4000)), "Quality"), "Quality has not been measured yet.");
}

TEST(Verdict, NamesNoPsnrWhereOnlyKernelsDiffer) {
  ConfigurationHistory original = trained("naive", {with_quality(history(20, 20), 28, 1000)});
  original.name = "naive-kernels";
  original.config.culling = "square";
  original.config.backward_kernel = "per-pixel";
  original.config.save_iterations = {7};
  const std::string text =
      verdict(summarize_comparison({original, trained("naive", {with_quality(history(10, 10), 25, 1000)})}, 4000));
  EXPECT_EQ(text.find("PSNR"), std::string::npos) << text;
}

TEST(Verdict, SeparatesLoadBalancingFromOtherOptions) {
  ConfigurationHistory original = trained("naive", {history(20, 20)});
  original.name = "naive-kernels";
  original.config.culling = "square";
  original.config.backward_kernel = "per-pixel";
  EXPECT_EQ(
      verdict(summarize_comparison(
          {original, trained("naive", {history(10, 10)}), trained("shared-memory", {history(5, 5)}),
           trained("adaptive", {with_kernel(history(4, 4), "segmented")})},
          4000)),
      "Load balancing saved 20.0 % of the training time of shared-memory, the fastest kernel without load "
      "balancing; shared-memory "
      "saved 50.0 % of the training time of naive; in total adaptive saved 60.0 % of the training time of naive "
      "(adaptive 16.0 s, shared-memory 20.0 s, "
      "naive 40.0 s). The configuration adaptive saved 80.0 % of the training time of naive-kernels, from which it "
      "differs in the forward kernel, backward_kernel and culling (adaptive 16.0 s, naive-kernels 80.0 s).");
}

TEST(Verdict, SavingsOfUnbalancedKernelsAreNotLoadBalancing) {
  const auto from_the_start = [](double ms) { return with_switch(history(ms, ms), 1); };
  EXPECT_EQ(
      verdict(summarize_pair({history(10, 10)}, {from_the_start(8)})),
      "Load balancing saved no time on this scene: shared-memory was faster from the start; with it ours saved 20.0 % "
      "of the training time of naive (ours 32.0 s, naive 40.0 s).");
  EXPECT_EQ(
      verdict(summarize_pair({history(10, 10)}, {from_the_start(12)})),
      "Load balancing saved no time on this scene: shared-memory was faster from the start; with it ours took 20.0 % "
      "longer than naive (ours 48.0 s, naive 40.0 s).");
  EXPECT_EQ(
      verdict(three(from_the_start(5.1))),
      "Load balancing saved no time on this scene: shared-memory was faster from the start; with it adaptive saved "
      "49.0 % of the training time of naive (adaptive 20.4 s, shared-memory 20.0 s, naive 40.0 s).");
  TrainHistory disabled = from_the_start(8);
  for (KernelCheckEvent& check : disabled.checks) check.disabled = {"combined"};
  EXPECT_EQ(verdict(summarize_pair({history(10, 10)}, {disabled})),
            "Load balancing saved no time on this scene: no load-balanced kernel was used; with shared-memory ours "
            "saved 20.0 % "
            "of the training time of naive (ours 32.0 s, naive 40.0 s).");
  EXPECT_EQ(verdict(three(history(4, 4))).find("adaptive saved 60.0 % of the training time of naive"), 0u)
      << "the log does not name kernels";
}

TEST(Verdict, DifferencesWithinRunToRunVariationAreNotSavings) {
  const auto summary = [](double again_ms) {
    ConfigurationHistory again = trained("naive", {history(again_ms, again_ms)});
    again.name = "naive_again";
    return summarize_comparison({trained("naive", {history(10, 10)}), trained("shared-memory", {history(5, 5)}),
                                 trained("adaptive", {with_kernel(history(4.9, 4.9), "segmented")}), again},
                                4000);
  };
  EXPECT_EQ(verdict(summary(10.01)),
            "Load balancing saved 2.0 % of the training time of shared-memory, the fastest kernel without load "
            "balancing; shared-memory "
            "saved 50.0 % of the training time of naive; in total adaptive saved 51.0 % of the training time of naive "
            "(adaptive 19.6 s, shared-memory 20.0 s, "
            "naive 40.0 s); two runs of naive differ by 0.1 %.");
  const std::string noisy = verdict(summary(9.9));
  EXPECT_EQ(noisy.find("Whether load balancing saves time is not clear: adaptive shows no clear difference in training "
                       "time from shared-memory, the fastest kernel without load balancing (time saved: 2.0 %; with "
                       "one seed, less than 12.7 % may be noise)"),
            0u)
      << noisy;
  EXPECT_NE(noisy.find("two runs of naive differ by 1.0 %"), std::string::npos);
  EXPECT_EQ(describe(summary(9.9).balancing[0]),
            "whether load balancing saves time is not clear: adaptive shows no clear difference in training time from "
            "shared-memory (time saved: 2.0 %; with one seed, less than 12.7 % may be noise); shared-memory saved 50.0 "
            "% of the training time of naive; in total adaptive saved 51.0 % of the training time of naive");
  EXPECT_NE(time_criterion(summary(9.9)).find("differences below 12.7 %, 12.7 times the run-to-run variation"),
            std::string::npos);
  EXPECT_EQ(describe(three(with_kernel(history(6, 6), "segmented")).balancing[0])
                .find("load balancing saved no time on this scene: adaptive took 20.0 % longer than shared-memory;"),
            0u);
}

TEST(Verdict, SaysIfSeedsAreMissing) {
  EXPECT_EQ(verdict(summarize_pair({history(10, 10, 3000)}, {history(8, 8, 1000)}, "shared-memory")),
            "Not finished: 1000 of 4000 iterations. So far: ours saved 20.0 % of the training time of naive (ours "
            "8.00 s, naive 10.00 s).");
  const ComparisonSummary one_of_three =
      summarize_pair({history(10, 10), history(10, 10, 500), TrainHistory{}},
                     {history(8, 8), TrainHistory{}, TrainHistory{}}, "shared-memory");
  EXPECT_EQ(one_of_three.done, 4000);
  EXPECT_EQ(one_of_three.done_by_seed, (std::vector<int>{4000, 0, 0}));
  EXPECT_EQ(one_of_three.seeds_started(), 1);
  EXPECT_EQ(one_of_three.compared[0].overall->n, 1);
  EXPECT_EQ(verdict(one_of_three),
            "Not finished: 4000 of 4000 iterations in 1 of 3 seeds. So far: ours saved 20.0 % of the training time of "
            "naive (ours 32.0 s, naive 40.0 s).");
  EXPECT_EQ(summarize_pair({TrainHistory{}}, {TrainHistory{}}).done, 0);
}

}  // namespace
}  // namespace b3dgs
