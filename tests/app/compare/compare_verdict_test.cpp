// The headline of a comparison, for synthetic histories.
#include <gtest/gtest.h>

#include <sstream>

#include "app/compare/compare_summary.h"
#include "app/compare/compare_verdict.h"
#include "app/compare/synthetic_histories.h"

namespace b3dgs {
namespace {

using namespace test;

/// The end of a verdict about times, with one seed.
const std::string kOneSeed =
    " One seed: this assumes that runs differ no more than the spread of their turns suggests.";

std::string verdict_of(const std::vector<ConfigurationHistory>& configurations) {
  return summarize_comparison(configurations, 4000, 100)["verdict"];
}

/// Returns the verdict for naive with 10 ms per step, sub-tile with 5, and `ours` as adaptive.
std::string three(const TrainHistory& ours) {
  return verdict_of({trained("naive", {history(10, 10)}), trained("sub-tile", {with_kernel(history(5, 5), "sub-tile")}),
                     trained("adaptive", {ours})});
}

TEST(Verdict, LoadBalancingIsComparedWithTheFastestUnbalancedKernel) {
  EXPECT_EQ(three(with_kernel(history(4, 4), "segmented")),
            "adaptive saved 60.0 % of the training time of naive (adaptive 16.0 s, naive 40.0 s); load balancing "
            "alone: adaptive saved 20.0 % of the training time of sub-tile, the fastest kernel without it." +
                kOneSeed);
  EXPECT_EQ(three(with_kernel(history(6, 6), "segmented")),
            "adaptive saved 40.0 % of the training time of naive (adaptive 24.0 s, naive 40.0 s); load balancing "
            "alone: adaptive took 20.0 % longer than sub-tile, the fastest kernel without it." +
                kOneSeed);
  EXPECT_EQ(three(with_kernel(history(4.8, 4.8), "segmented")),
            "adaptive saved 52.0 % of the training time of naive (adaptive 19.2 s, naive 40.0 s); load balancing "
            "alone: adaptive shows no clear difference in training time from sub-tile (time saved: 4.0 %; with "
            "one seed, less than 10.0 % may be chance), the fastest kernel without it." +
                kOneSeed);
  EXPECT_EQ(verdict_of({trained("naive", {history(10, 10)}), trained("shared-memory", {history(12, 12)}),
                        trained("combined", {with_kernel(history(8, 8), "combined")})}),
            "combined saved 20.0 % of the training time of naive (combined 32.0 s, naive 40.0 s); load balancing "
            "alone: combined saved 20.0 % of the training time of naive, the fastest kernel without it." +
                kOneSeed)
      << "without an adaptive configuration, the verdict is about the balanced one";
}

TEST(Verdict, SeveralSeedsTellSmallDifferencesFromChance) {
  const auto trained_for = [](const std::string& kernel, std::vector<double> ms) {
    std::vector<TrainHistory> runs;
    for (const double own : ms) runs.push_back(with_kernel(history(own, own), kernel));
    return trained(kernel, runs);
  };
  const auto balancing = [&](std::vector<double> ms) {
    const std::string text = verdict_of(
        {trained_for("naive", {10, 10, 10}), trained_for("sub-tile", {5, 5, 5}), trained_for("segmented", ms)});
    return text.substr(text.find("alone: ") + 7);
  };
  EXPECT_EQ(balancing({4.8, 4.79, 4.81}),
            "segmented saved 4.0 % of the training time of sub-tile (95 % interval 3.5 to 4.5 %), the fastest "
            "kernel without it.");
  EXPECT_EQ(balancing({5.2, 5.19, 5.21}),
            "segmented took 4.0 % longer than sub-tile (95 % interval 3.5 to 4.5 %), the fastest kernel without "
            "it.");
  EXPECT_EQ(balancing({4.99, 5, 5}),
            "segmented took as long as sub-tile (95 % interval -0.2 to 0.4 %), the fastest kernel without it.");
  EXPECT_EQ(balancing({4.6, 5, 5.1}),
            "segmented shows no clear difference in training time from sub-tile (time saved: 2.0 %, 95 % interval "
            "-11.1 to 15.1 %), the fastest kernel without it.");
}

TEST(Verdict, WithoutAllUnbalancedKernelsTheShareOfLoadBalancingIsUnknown) {
  const auto pair = [](TrainHistory ours, const char* kernel = "sub-tile") {
    return summarize_pair({history(10, 10)}, {std::move(ours)}, kernel)["verdict"].get<std::string>();
  };
  EXPECT_EQ(pair(with_kernel(history(8, 9.5), "segmented"), "adaptive"),
            "ours saved 12.5 % of the training time of naive (ours 35.0 s, naive 40.0 s); what load balancing "
            "contributes is unknown, since sub-tile was not trained." +
                kOneSeed);
  EXPECT_EQ(pair(history(8, 8)),
            "ours saved 20.0 % of the training time of naive (ours 32.0 s, naive 40.0 s)." + kOneSeed);
  EXPECT_EQ(pair(history(12, 12)), "ours took 20.0 % longer than naive (ours 48.0 s, naive 40.0 s)." + kOneSeed);
  EXPECT_EQ(pair(TrainHistory{}), "No result yet: not every configuration has been trained.");
}

TEST(Verdict, OtherOptionsAreNoLoadBalancing) {
  ConfigurationHistory ours = trained("adaptive", {with_kernel(history(6, 6), "segmented")});
  ours.config.sh_degree = 0;
  EXPECT_EQ(verdict_of({trained("naive", {history(10, 10)}), trained("sub-tile", {history(5, 5)}), ours}),
            "adaptive saved 40.0 % of the training time of naive (adaptive 24.0 s, naive 40.0 s)." + kOneSeed +
                " No views were held out (--no_eval), so quality was not measured.");

  ConfigurationHistory original = trained("naive", {history(20, 20)});
  original.name = "naive-kernels";
  original.config.culling = Culling::kSquare;
  EXPECT_EQ(verdict_of({original, trained("naive", {history(10, 10)}), trained("sub-tile", {history(5, 5)}),
                        trained("adaptive", {with_kernel(history(4, 4), "segmented")})}),
            "adaptive saved 80.0 % of the training time of naive-kernels (adaptive 16.0 s, naive-kernels 80.0 s); load "
            "balancing alone: adaptive saved 20.0 % of the training time of sub-tile, the fastest kernel without "
            "it." +
                kOneSeed);
}

/// Returns a configuration with another learning rate.
ConfigurationHistory with_other_rate(const std::string& name, std::vector<TrainHistory> by_seed) {
  ConfigurationHistory own = trained("naive", std::move(by_seed));
  own.name = name;
  own.config.feature_lr *= 2;
  return own;
}

TEST(Verdict, NamesThePsnrOfConfigurationsThatLearnDifferently) {
  const auto measured = [](double psnr, double ms = 5) { return with_quality(history(ms, ms), psnr, 1000); };
  std::vector<ConfigurationHistory> all{
      trained("naive", {measured(28.3)}), with_other_rate("fast", {measured(26.1, 4)}),
      with_other_rate("fine", {measured(29.5)}), with_other_rate("same", {measured(28.35)})};
  for (ConfigurationHistory& own : all) own.config.eval = true;
  EXPECT_EQ(
      verdict_of(all),
      "fast saved 20.0 % of the training time of naive (fast 16.0 s, naive 20.0 s)." + kOneSeed +
          " PSNR of the test views, compared with naive: fast -2.20 dB, fine +1.20 dB, same +0.05 dB, which may "
          "be chance. One seed: differences below 1 dB may be chance, assuming that runs vary by at most 0.2 dB.");
  std::vector<ConfigurationHistory> equal = all;
  equal[3].by_seed = {measured(28.304)};
  equal.push_back({"naive_again", equal[0].config, {measured(28.4)}});
  const std::string with_noise = verdict_of(equal);
  EXPECT_NE(with_noise.find("fast -2.20 dB, fine +1.20 dB, which may be chance, same +0.00 dB, so equal. One seed: "
                            "differences below 1.27 dB may be chance, judging by two runs of naive."),
            std::string::npos)
      << with_noise;
  EXPECT_EQ(verdict_of({trained("naive", {measured(28), measured(29), measured(28.5)}),
                        with_other_rate("fast", {measured(27.5, 6), measured(28.48, 6), measured(28.02, 6)}),
                        with_other_rate("same", {measured(28.01), measured(29), measured(28.5)}),
                        with_other_rate("odd", {measured(28.5), measured(28.6), measured(28.41)})}),
            "fast took 20.0 % longer than naive (95 % interval 20.0 to 20.0 %; fast 24.0 s, naive 20.0 s). PSNR of "
            "the test views, compared with naive: fast -0.50 dB (95 % interval -0.55 to -0.45), same +0.00 dB (95 % "
            "interval -0.01 to +0.02), so equal, odd +0.00 dB (95 % interval -1.13 to +1.14), which may be chance.");
  const auto last_sentence = [&] {
    const std::string text = verdict_of(all);
    return text.substr(text.find(kOneSeed) + kOneSeed.size() + 1);
  };
  for (ConfigurationHistory& own : all) own.by_seed = {with_quality(history(50, 50, 1000), 20, 10)};
  EXPECT_EQ(last_sentence().find("PSNR of the test views after 1000 iterations, compared with naive: fast +0.00 dB"),
            0u);
  for (ConfigurationHistory& own : all) own.by_seed = {history(50, 50, 1000)};
  EXPECT_EQ(last_sentence(), "Quality has not been measured yet.");
}

TEST(Verdict, NamesNoPsnrWhereOnlyKernelsDiffer) {
  ConfigurationHistory original = trained("naive", {with_quality(history(20, 20), 28, 1000)});
  original.name = "naive-kernels";
  original.config.culling = Culling::kSquare;
  original.config.save_iterations = {7};
  const std::string text = verdict_of({original, trained("naive", {with_quality(history(10, 10), 25, 1000)})});
  EXPECT_EQ(text.find("PSNR"), std::string::npos) << text;
}

TEST(Verdict, SavingsOfUnbalancedKernelsAreNotLoadBalancing) {
  EXPECT_EQ(three(with_switch(history(5.1, 5.1), 1)),
            "adaptive saved 49.0 % of the training time of naive (adaptive 20.4 s, naive 40.0 s); load balancing saved "
            "no time: no load-balanced kernel was used." +
                kOneSeed);
  EXPECT_EQ(summarize_pair({history(10, 10)}, {with_switch(history(9.5, 9.5), 1)})["verdict"],
            "ours shows no clear difference in training time from naive (time saved: 5.0 %; with one seed, less than "
            "10.0 % may be chance; ours 38.0 s, naive 40.0 s); load balancing saved no time: no load-balanced kernel "
            "was used." +
                kOneSeed)
      << "even if not every unbalanced kernel was trained";
}

TEST(Verdict, DifferencesWithinRunToRunVariationAreNotSavings) {
  const auto text = [](double again_ms) {
    ConfigurationHistory again = trained("naive", {history(again_ms, again_ms)});
    again.name = "naive_again";
    return verdict_of({trained("naive", {history(10, 10)}), trained("sub-tile", {history(5, 5)}),
                       trained("adaptive", {with_kernel(history(4.9, 4.9), "segmented")}), again});
  };
  EXPECT_EQ(text(10.01),
            "adaptive saved 51.0 % of the training time of naive (adaptive 19.6 s, naive 40.0 s); load balancing "
            "alone: adaptive saved 2.0 % of the training time of sub-tile, the fastest kernel without it; two "
            "runs of naive differ by 0.1 %." +
                kOneSeed);
  EXPECT_EQ(text(9.9),
            "adaptive saved 51.0 % of the training time of naive (adaptive 19.6 s, naive 40.0 s); load balancing "
            "alone: adaptive shows no clear difference in training time from sub-tile (time saved: 2.0 %; with "
            "one seed, less than 12.7 % may be chance), the fastest kernel without it; two runs of naive differ by 1.0 "
            "%." +
                kOneSeed);
}

TEST(Verdict, SaysIfSeedsAreMissing) {
  EXPECT_EQ(summarize_pair({history(10, 10, 3000)}, {history(8, 8, 2000)}, "sub-tile")["verdict"],
            "Not finished: 2000 of 4000 iterations. So far: ours saved 20.0 % of the training time of naive (ours "
            "16.0 s, naive 20.0 s)." +
                kOneSeed);
  const nlohmann::ordered_json one_of_three =
      summarize_pair({history(10, 10), history(10, 10, 500), TrainHistory{}},
                     {history(8, 8), TrainHistory{}, TrainHistory{}}, "sub-tile");
  EXPECT_EQ(one_of_three["done"], 4000);
  EXPECT_EQ(one_of_three["done_by_seed"], (std::vector<int>{4000, 0, 0}));
  EXPECT_EQ(one_of_three["compared"][0]["saved_overall"]["n"], 1);
  EXPECT_EQ(one_of_three["verdict"],
            "Not finished: 4000 of 4000 iterations in 1 of 3 seeds. So far: ours saved 20.0 % of the training time of "
            "naive (ours 32.0 s, naive 40.0 s)." +
                kOneSeed);
  EXPECT_EQ(summarize_pair({TrainHistory{}}, {TrainHistory{}})["done"], 0);
}

TEST(Verdict, DoesNotCompareTimesOfShortTrainings) {
  const auto text = [](double ms, int until) {
    return verdict_of({trained("naive", {history(2 * ms, 2 * ms, until)}),
                       trained("sub-tile", {with_kernel(history(ms, ms, until), "sub-tile")}),
                       trained("adaptive", {with_kernel(history(ms, ms, until), "segmented")})});
  };
  EXPECT_EQ(text(2, 4000),
            "adaptive against naive: too short to judge the training time (adaptive 8.00 s, naive 16.00 s); load "
            "balancing alone: too short to judge. Times need at least 10 turns and 10 s of each configuration.");
  EXPECT_EQ(text(200, 200),
            "Not finished: 200 of 4000 iterations. So far: adaptive against naive: too short to judge the training "
            "time (adaptive 40.0 s, naive 80.0 s); load balancing alone: too short to judge. Times need at least 10 "
            "turns and 10 s of each configuration.");
}

/// Returns the first four cells of the line that begins with `name`.
std::string times_in_table(const nlohmann::ordered_json& summary, const std::string& name) {
  const std::string table = summary_table(summary);
  std::istringstream line(table.substr(table.find("\n" + name) + 1));
  std::string text, word;
  for (int i = 0; i < 4 && line >> word; ++i) text += word + " ";
  return text;
}

TEST(SummaryTable, TimesAreThoseOfOneNumberOfIterations) {
  const nlohmann::ordered_json in_a_turn =
      summarize_comparison({trained("naive", {history(10, 10)}), trained("shared-memory", {history(9, 9)}),
                            trained("combined", {history(8, 8, 2000)})},
                           4000, 100);
  EXPECT_EQ(times_in_table(in_a_turn, "naive"), "naive 30,000 20.00 - ");
  EXPECT_EQ(times_in_table(in_a_turn, "shared-memory"), "shared-memory 30,000 18.00 10.0 ");
  EXPECT_EQ(times_in_table(in_a_turn, "combined"), "combined 30,000 16.00 20.0 ");
  const nlohmann::ordered_json second_seed_begun =
      summarize_pair({history(10, 10), history(10, 10, 1000)}, {history(8, 8), history(8, 8, 1000)});
  EXPECT_EQ(times_in_table(second_seed_begun, "naive"), "naive 30,000 40.00 - ");
  EXPECT_EQ(times_in_table(second_seed_begun, "ours"), "ours 30,000 32.00 20.0 ");
}

}  // namespace
}  // namespace b3dgs
