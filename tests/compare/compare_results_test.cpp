// What each configuration has reached at the end of its own training.
#include "compare/compare_results.h"

#include <gtest/gtest.h>

#include "compare/compare_verdict.h"
#include "synthetic_histories.h"

namespace b3dgs {
namespace {

using test::history;
using test::with_quality;

ConfigurationHistory of_length(const std::string& name, int iterations, std::vector<TrainHistory> by_seed) {
  TrainConfig config;
  config.iterations = iterations;
  config.strategy = kDensityStrategies.front();
  return {name, config, std::move(by_seed)};
}

/// 40 s and 8 s; the second seed of `fast` is not finished.
std::vector<ConfigurationHistory> of_two_lengths() {
  return {of_length("inria", 4000, {with_quality(history(1, 1), 28, 900000), with_quality(history(1, 1), 29, 1000000)}),
          of_length("fast", 1000,
                    {with_quality(history(0.8, 1, 1000), 28.75, 200000), with_quality(history(0.8, 1, 500), 20, 5)})};
}

TEST(FinalResults, AreThoseOfEachConfigurationsOwnEnd) {
  const std::vector<FinalResult> results = final_results(of_two_lengths());
  ASSERT_EQ(results.size(), 2u);
  EXPECT_EQ(results[0].n_complete, 2);
  EXPECT_NEAR(results[0].seconds->mean, 4, 1e-9);
  EXPECT_EQ(results[0].psnr->mean, 28.5);
  EXPECT_EQ(results[0].psnr->min, 28);
  EXPECT_EQ(results[0].count->mean, 950000);
  EXPECT_EQ(results[1].iterations, 1000);
  EXPECT_EQ(results[1].n_complete, 1) << "unfinished trainings do not count";
  EXPECT_NEAR(results[1].seconds->mean, 0.8, 1e-9);
  EXPECT_EQ(results[1].psnr->mean, 28.75);
  EXPECT_FALSE(have_equal_lengths(results));
}

TEST(FinalResults, AreTheVerdictWhereLengthsDiffer) {
  const ComparisonSummary summary = summarize_comparison(of_two_lengths(), 4000);
  EXPECT_EQ(verdict(summary),
            "Not finished. So far: inria 4.0 s, 28.50 dB, 950,000 Gaussians; fast 0.8 s, 28.75 dB, 200,000 "
            "Gaussians. PSNR of the held-out views, compared with inria: fast +0.75 dB, may be chance in 1 of 2 "
            "seeds. One seed: differences below 1 dB say nothing.");
  std::vector<ConfigurationHistory> complete = of_two_lengths();
  complete[1].by_seed[1] = complete[1].by_seed[0];
  EXPECT_EQ(verdict(summarize_comparison(complete, 4000)),
            "inria 4.0 s, 28.50 dB, 950,000 Gaussians; fast 0.8 s, 28.75 dB, 200,000 Gaussians. PSNR of the "
            "held-out views, compared with inria: fast +0.25 dB, may be chance, 95 % interval -6.10 to +6.60.");
  EXPECT_EQ(to_json(summary)["results"][1]["psnr"]["mean"], 28.75);
  EXPECT_EQ(to_json(summary)["results"][1]["psnr_gained"]["finding"], "unclear");
  std::vector<ConfigurationHistory> unmeasured{of_length("inria", 4000, {history(1, 1)}),
                                               of_length("fast", 1000, {history(0.8, 1, 1000)})};
  EXPECT_EQ(verdict(summarize_comparison(unmeasured, 4000)),
            "inria 4.0 s; fast 0.8 s. No views were held out (--no_eval), so quality was not measured.");
  for (ConfigurationHistory& own : complete) own.by_seed = {TrainHistory{}, TrainHistory{}};
  EXPECT_NE(verdict(summarize_comparison(complete, 4000)).find("No result yet"), std::string::npos);
}

}  // namespace
}  // namespace b3dgs
