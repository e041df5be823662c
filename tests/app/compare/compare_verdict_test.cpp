// The headline and the tables of a comparison, for synthetic histories.
#include "app/compare/compare_verdict.h"

#include <gtest/gtest.h>

#include "app/compare/synthetic_histories.h"

namespace b3dgs {
namespace {

using namespace test;
using Json = nlohmann::ordered_json;

const std::string kOneSeed = "one seed, assuming that runs differ no more than the spread of their turns suggests";
const std::string kNoQuality = "; quality was not measured, because no views were held out (--no_eval).";

Json summary_of(const std::vector<ConfigurationHistory>& configurations) {
  return summarize_comparison(configurations, 4000, 100);
}

/// Returns runs with these times per step.
std::vector<TrainHistory> runs(const std::vector<double>& ms, const std::string& kernel = "segmented") {
  std::vector<TrainHistory> runs;
  for (const double own : ms) runs.push_back(with_kernel(history(own, own), kernel));
  return runs;
}

TEST(Verdict, SaysHowMuchTimeWasSavedOrThatItMayBeChance) {
  const auto time = [](const std::vector<double>& naive_ms, const std::vector<double>& ms) {
    const std::string text = summarize_pair(runs(naive_ms), runs(ms))["verdict"];
    EXPECT_EQ(text.find(kNoQuality), text.size() - kNoQuality.size()) << text;
    return text.substr(0, text.find(';'));
  };
  EXPECT_EQ(time({10}, {8}), "ours saved 20.0 % of the training time of naive (" + kOneSeed + ")");
  EXPECT_EQ(time({10}, {12}), "ours took longer than naive (time saved -20.0 %, " + kOneSeed + ")");
  EXPECT_EQ(time({10}, {10}), "ours took as long as naive (time saved 0.0 %, " + kOneSeed + ")");
  EXPECT_EQ(
      time({10}, {9.5}),
      "ours shows no clear difference in training time from naive (time saved 5.0 %, one seed, less than 10 % may "
      "be chance, assuming that runs differ no more than the spread of their turns suggests)");
  EXPECT_EQ(time({10, 10, 10}, {9.6, 9.58, 9.62}),
            "ours saved 4.0 % of the training time of naive (95 % interval 3.5 to 4.5 %)");
  EXPECT_EQ(time({10, 10, 10}, {10.4, 10.38, 10.42}),
            "ours took longer than naive (time saved -4.0 %, 95 % interval -4.5 to -3.5 %)");
  EXPECT_EQ(time({10, 10, 10}, {9.98, 10, 10}),
            "ours took as long as naive (time saved 0.1 %, 95 % interval -0.2 to 0.4 %)");
  EXPECT_EQ(time({10, 10, 10}, {9.2, 10, 10.2}),
            "ours shows no clear difference in training time from naive (time saved 2.0 %, 95 % interval -11.1 to 15.1 "
            "%)");
  EXPECT_EQ(time({4}, {2}),
            "ours and naive ran for too short a time to compare them (it takes 10 turns and 10 s of each)");
}

TEST(Verdict, SaysWhetherQualityDiffers) {
  const auto quality = [](const std::vector<double>& naive, const std::vector<double>& ours, double again = 0) {
    std::vector<ConfigurationHistory> all{trained("naive", {}), {"ours", config_with("adaptive"), {}}};
    all[0].config.eval = true;
    for (const double psnr : naive) all[0].by_seed.push_back(with_quality(history(10, 10), psnr, 1000));
    for (const double psnr : ours) all[1].by_seed.push_back(with_quality(history(8, 8), psnr, 1000));
    if (again > 0) all.push_back({"again", all[0].config, {with_quality(history(10, 10), again, 1000)}});
    const std::string text = summary_of(all)["verdict"];
    return text.substr(text.find("; ") + 2);
  };
  EXPECT_EQ(quality({28}, {26}),
            "the PSNR of ours differs (-2.00 dB, one seed, assuming that runs vary by at most 0.2 dB).");
  EXPECT_EQ(quality({28}, {28.004}),
            "the PSNR of ours is equal (+0.00 dB, one seed, assuming that runs vary by at most 0.2 dB).");
  EXPECT_EQ(
      quality({28}, {28.05}),
      "the PSNR of ours shows no clear difference (+0.05 dB, one seed, less than 1 dB may be chance, assuming that "
      "runs vary by at most 0.2 dB).");
  EXPECT_EQ(
      quality({28}, {29.2}, 28.1),
      "the PSNR of ours shows no clear difference (+1.20 dB, one seed, less than 1.27 dB may be chance, judging by "
      "two runs of naive).");
  EXPECT_EQ(quality({28, 29, 28.5}, {27.5, 28.48, 28.02}),
            "the PSNR of ours differs (-0.50 dB, 95 % interval -0.55 to -0.45 dB).");
  EXPECT_EQ(quality({28, 29, 28.5}, {28.01, 29, 28.5}),
            "the PSNR of ours is equal (+0.00 dB, 95 % interval -0.01 to +0.02 dB).");
  EXPECT_EQ(quality({28, 29, 28.5}, {28.5, 28.6, 28.41}),
            "the PSNR of ours shows no clear difference (+0.00 dB, 95 % interval -1.13 to +1.14 dB).");

  std::vector<ConfigurationHistory> all{trained("naive", {with_quality(history(50, 50, 1000), 20, 10)}),
                                        trained("adaptive", {with_quality(history(50, 50, 1000), 20, 10)})};
  all[0].config.eval = true;
  EXPECT_NE(summary_of(all)["verdict"].get<std::string>().find("the PSNR of adaptive after 1,000 iterations is equal"),
            std::string::npos);
  for (ConfigurationHistory& own : all) own.by_seed = {history(50, 50, 1000)};
  EXPECT_NE(summary_of(all)["verdict"].get<std::string>().find("; quality has not been measured yet."),
            std::string::npos);
}

TEST(Verdict, SaysIfTrainingIsNotFinished) {
  EXPECT_EQ(summarize_pair({history(10, 10, 3000)}, {history(8, 8, 2000)})["verdict"],
            "Not finished: 2000 of 4000 iterations. So far: ours saved 20.0 % of the training time of naive (" +
                kOneSeed + ")" + kNoQuality);
  const Json one_of_three = summarize_pair({history(10, 10), history(10, 10, 500), TrainHistory{}},
                                           {history(8, 8), TrainHistory{}, TrainHistory{}});
  EXPECT_EQ(one_of_three["done"], 4000);
  EXPECT_EQ(one_of_three["done_by_seed"], (std::vector<int>{4000, 0, 0}));
  EXPECT_EQ(one_of_three["compared"][0]["saved_overall"]["n"], 1);
  EXPECT_EQ(one_of_three["verdict"],
            "Not finished: 4000 of 4000 iterations in 1 of 3 seeds. So far: ours saved 20.0 % of the training time of "
            "naive (" +
                kOneSeed + ")" + kNoQuality);
  EXPECT_EQ(summarize_pair({history(10, 10)}, {TrainHistory{}})["verdict"],
            "No result yet: not every configuration has been trained.");
}

TEST(BalancingTable, ComparesWithTheFastestKernelWithoutLoadBalancing) {
  const auto row = [](const TrainHistory& ours) {
    return row_of(balancing_table(summary_of({trained("naive", runs({10})), trained("sub-tile", runs({5}, "sub-tile")),
                                              trained("adaptive", {ours})})),
                  "adaptive against sub-tile");
  };
  EXPECT_EQ(row(with_kernel(history(4, 4), "segmented")), "adaptive against sub-tile | 20.0 % | 10 % | faster");
  EXPECT_EQ(row(with_kernel(history(6, 6), "segmented")), "adaptive against sub-tile | -20.0 % | 10 % | slower");
  EXPECT_EQ(row(with_kernel(history(4.8, 4.8), "segmented")), "adaptive against sub-tile | 4.0 % | 10 % | unclear");
  EXPECT_EQ(row(with_switch(history(5.1, 5.1), 1)), "adaptive against sub-tile | -2.0 % | 10 % | unclear")
      << "what sub-tile saves against naive is not load balancing";
  EXPECT_EQ(row_of(balancing_table(summary_of({trained("naive", runs({10})), trained("shared-memory", runs({12})),
                                               trained("combined", runs({8}))})),
                   "combined against naive"),
            "combined against naive | 20.0 % | 10 % | faster");
  EXPECT_EQ(
      row_of(balancing_table(summary_of({trained("naive", runs({10, 10, 10})), trained("sub-tile", runs({5, 5, 5})),
                                         trained("segmented", runs({4.8, 4.79, 4.81}))})),
             "segmented against sub-tile"),
      "segmented against sub-tile | 4.0 % | 3.5 to 4.5 % | faster");
  EXPECT_EQ(row_of(balancing_table(summary_of(
                       {trained("naive", runs({4})), trained("sub-tile", runs({2})), trained("adaptive", runs({2}))})),
                   "adaptive against sub-tile"),
            "adaptive against sub-tile | 0.0 % | too short");
}

TEST(BalancingTable, CreditsOnlyConfigurationsThatDifferInNothingButTheKernel) {
  EXPECT_TRUE(balancing_table(summary_of({trained("naive", runs({10})), trained("adaptive", runs({4}))})).empty())
      << "sub-tile may be as fast";
  ConfigurationHistory ours = trained("adaptive", runs({6}));
  ours.config.sh_degree = 0;
  EXPECT_TRUE(
      balancing_table(summary_of({trained("naive", runs({10})), trained("sub-tile", runs({5})), ours})).empty());
  ConfigurationHistory original = trained("naive", runs({20}));
  original.name = "naive-kernels";
  original.config.culling = Culling::kSquare;
  const TextTable table = balancing_table(summary_of(
      {original, trained("naive", runs({10})), trained("sub-tile", runs({5})), trained("adaptive", runs({4}))}));
  EXPECT_EQ(row_of(table, "adaptive against sub-tile"), "adaptive against sub-tile | 20.0 % | 10 % | faster");
}

TEST(PaperTable, HasTheNumbersOfThePaperBesideTheSameComparison) {
  const auto table = [](const TrainHistory& first, const TrainHistory& second) {
    return paper_table(summarize_pair({history(10, 10), history(10, 10)}, {first, second}, kPublishedKernel));
  };
  const TrainHistory ours = history(8, 9.5), switches = with_switch(ours, 2001, "combined", "shared-memory"),
                     later = with_switch(ours, 3001, "combined", "shared-memory"),
                     never = with_kernel(ours, "combined");
  EXPECT_EQ(row_of(table(switches, switches), "time saved"),
            "time saved | up to the inflection | from it | overall | 95 % interval | finding | inflection");
  EXPECT_EQ(row_of(table(switches, switches), "in the paper"),
            "in the paper | 19.6 % | 7.9 % | 8.5 % | - | - | about 2,000");
  const auto row = [&](const TrainHistory& first, const TrainHistory& second) {
    return row_of(table(first, second), "ours against naive");
  };
  EXPECT_EQ(row(switches, switches), "ours against naive | 20.0 % | 5.0 % | 12.5 % | 5.1 to 19.9 % | faster | 2,001");
  EXPECT_EQ(row(switches, later),
            "ours against naive | 17.5 % | 5.0 % | 12.5 % | 5.1 to 19.9 % | faster | 2,001 to 3,001");
  EXPECT_EQ(row(never, never), "ours against naive | no switch | no switch | 12.5 % | 5.1 to 19.9 % | faster | -");
  EXPECT_EQ(row(never, switches),
            "ours against naive | 20.0 % in 1 of 2 seeds | 5.0 % in 1 of 2 seeds | 12.5 % | 5.1 "
            "to 19.9 % | faster | 2,001");
  EXPECT_EQ(row(TrainHistory{}, TrainHistory{}), "ours against naive | - | - | - | -");
  EXPECT_TRUE(paper_table(summarize_pair({history(10, 10)}, {ours}, "combined")).empty());
}

TEST(ResultsTable, HasTheRepeatedBaselineBesideEveryDifference) {
  ConfigurationHistory again = trained("naive", runs({9.9}));
  again.name = "naive_again";
  const TextTable table =
      results_table(summary_of({trained("naive", runs({10})), trained("sub-tile", runs({8})), again}));
  EXPECT_EQ(row_of(table, "sub-tile"), "sub-tile | 30,000 | 32.00 | 20.0 % | 12.7 % | faster");
  EXPECT_EQ(row_of(table, "naive_again"), "naive_again | 30,000 | 39.60 | 1.0 % | 12.7 % | unclear");
}

TEST(ResultsTable, TimesAreThoseOfOneNumberOfIterations) {
  const TextTable in_a_turn =
      results_table(summary_of({trained("naive", {history(10, 10)}), trained("shared-memory", {history(8.5, 8.5)}),
                                trained("combined", {history(8, 8, 2000)})}));
  EXPECT_EQ(row_of(in_a_turn, "naive"), "naive | 30,000 | 20.00 | - | - | -");
  EXPECT_EQ(row_of(in_a_turn, "shared-memory"), "shared-memory | 30,000 | 17.00 | 15.0 % | 10 % | faster");
  EXPECT_EQ(row_of(in_a_turn, "combined"), "combined | 30,000 | 16.00 | 20.0 % | 10 % | faster");
  const TextTable second_seed_begun =
      results_table(summarize_pair({history(10, 10), history(10, 10, 1000)}, {history(8, 8), history(8, 8, 1000)}));
  EXPECT_EQ(row_of(second_seed_begun, "naive"), "naive | 30,000 | 40.00 | - | - | -");
  EXPECT_EQ(row_of(second_seed_begun, "ours"), "ours | 30,000 | 32.00 | 20.0 % | 10 % | faster");
}

}  // namespace
}  // namespace b3dgs
