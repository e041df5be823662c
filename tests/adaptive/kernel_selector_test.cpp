// Tests the rule by which training chooses between two kernels, with invented times.
#include "adaptive/kernel_selector.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

#include "core/check.h"
#include "support/expect_error.h"

namespace b3dgs {
namespace {

KernelSelector selector(KernelPolicy policy = KernelPolicy::kAdaptive, int interval = 1000) {
  return KernelSelector({"balanced", "plain", policy, interval});
}

std::vector<ViewTimes> views(int n, double in_use_ms, double other_ms) {
  return std::vector<ViewTimes>(static_cast<std::size_t>(n), {in_use_ms, other_ms});
}

TEST(KernelSelector, ChecksTheFirstViewsAndTheFirstAfterEachInterval) {
  const KernelSelector own = selector();
  for (const auto& [iteration, check] :
       {std::pair(0, -1), {1, 0}, {5, 0}, {6, -1}, {1000, -1}, {1001, 1}, {1005, 1}, {1006, -1}, {24001, 24}}) {
    EXPECT_EQ(own.check_of(iteration), check) << iteration;
  }
  EXPECT_EQ(selector(KernelPolicy::kAdaptive, 2).check_of(7), 3) << "a short interval is checked throughout";
  EXPECT_EQ(KernelSelector({"only", ""}).check_of(1), -1) << "there is no choice";
}

TEST(KernelSelector, RefusesRulesThatDoNotFit) {
  EXPECT_THROW(KernelSelector({"", "plain"}), LogicError);
  EXPECT_THROW(KernelSelector({"same", "same"}), LogicError);
  EXPECT_THROW(selector(KernelPolicy::kAdaptive, 0), LogicError);
}

TEST(KernelSelector, DecidesByTheSumSoThatCrowdedViewsCount) {
  // By the median of the ratios, the plain kernel would be 3 % faster.
  const std::vector<ViewTimes> crowded{{0.103, 0.100}, {0.103, 0.100}, {0.103, 0.100}, {0.5, 1.5}, {0.5, 1.5}};
  for (const KernelPolicy policy : {KernelPolicy::kAdaptive, KernelPolicy::kPublished}) {
    KernelSelector own = selector(policy);
    const KernelDecision decision = own.decide(2009, crowded);
    EXPECT_EQ(decision.after, "balanced");
    EXPECT_EQ(own.kernel(), "balanced");
    EXPECT_NEAR(decision.times_ms.at("balanced"), 1.309 / 5, 1e-9);
    EXPECT_NEAR(decision.times_ms.at("plain"), 3.3 / 5, 1e-9);
  }
}

TEST(KernelSelector, SwitchesToAKernelThatIsFasterBeyondDoubtAndBack) {
  KernelSelector own = selector();
  const KernelDecision decision = own.decide(1009, views(8, 2.0, 1.0));
  EXPECT_EQ(decision.before, "balanced");
  EXPECT_EQ(decision.after, "plain");
  EXPECT_EQ(decision.views, 8);
  EXPECT_EQ(decision.iteration, 1009);
  EXPECT_EQ(decision.message, "iteration 1009: balanced 2 ms, plain 1 ms: using plain");
  EXPECT_EQ(own.kernel(), "plain");
  EXPECT_EQ(own.other(), "balanced");
  EXPECT_EQ(own.decide(2009, views(8, 1.0, 2.0)).message, "") << "it is still the faster";
  EXPECT_EQ(own.decide(3009, views(8, 1.0, 0.9)).after, "balanced");
}

TEST(KernelSelector, KeepsTheKernelIfTheLeadMayBeChance) {
  EXPECT_EQ(selector().decide(9, views(8, 1.0, 0.991)).after, "balanced") << "below 1 %";
  EXPECT_EQ(selector().decide(9, views(8, 1.0, 0.989)).after, "plain");
  // Differences of 0.3 and -0.1 ms give a lead of 0.8 ms with a standard error of sqrt(8) x 0.2138 = 0.605.
  std::vector<ViewTimes> uneven;
  for (int i = 0; i < 8; ++i) uneven.push_back({1.0, i % 2 == 0 ? 0.7 : 1.1});
  const KernelDecision decision = selector().decide(9, uneven);
  EXPECT_EQ(decision.after, "balanced");
  EXPECT_NEAR(decision.error_ms, 0.6047 / 8, 1e-4);
  EXPECT_EQ(decision.reason, "plain takes 10.0 % less, standard error 7.6 %");
}

TEST(KernelSelector, NoiseHardlyEverSelectsTheSlowerKernel) {
  std::mt19937 random(5);
  std::normal_distribution<double> noise(0, 0.03);
  int n_wrong = 0;
  for (int check = 0; check < 1000; ++check) {
    std::vector<ViewTimes> times;
    for (int i = 0; i < KernelSelector::kViews; ++i) {
      times.push_back({(1 + i) * (1 + noise(random)), 1.03 * (1 + i) * (1 + noise(random))});
    }
    n_wrong += selector().decide(1009, times).after == "plain";
  }
  EXPECT_LE(n_wrong, 2);
}

TEST(KernelSelector, PublishedSwitchesOnceForAnyLeadButNotBeforeTheFirstInterval) {
  KernelSelector own = selector(KernelPolicy::kPublished);
  EXPECT_EQ(own.decide(9, views(8, 2.0, 1.0)).after, "balanced") << "the paper's first check comes after an interval";
  EXPECT_EQ(own.decide(1009, views(8, 1.0, 1.001)).after, "balanced");
  const KernelDecision decision = own.decide(2009, views(8, 1.0, 0.999));
  EXPECT_EQ(decision.after, "plain");
  EXPECT_NE(decision.message.find("using plain for the rest"), std::string::npos) << decision.message;
  EXPECT_EQ(own.decide(3009, views(8, 2.0, 1.0)).after, "plain") << "times are logged, but nothing changes any more";
  EXPECT_EQ(own.check_of(4002), 4);
  EXPECT_EQ(own.check_of(4003), -1) << "which takes fewer views";
}

TEST(KernelSelector, FixedOnlyLogs) {
  KernelSelector own = selector(KernelPolicy::kFixed);
  const KernelDecision decision = own.decide(1009, views(8, 2.0, 1.0));
  EXPECT_EQ(decision.after, "balanced");
  EXPECT_EQ(decision.times_ms.at("plain"), 1.0);
}

TEST(KernelSelector, LeavesOutTimesThatAreNotValid) {
  std::vector<ViewTimes> times = views(3, 2.0, 1.0);
  for (const double bad : {0.0, -1.0, std::nan(""), std::numeric_limits<double>::infinity()}) {
    times.push_back({bad, 100});
    times.push_back({1, bad});
  }
  const KernelDecision decision = selector().decide(1009, times);
  EXPECT_EQ(decision.views, 3);
  EXPECT_EQ(decision.times_ms.at("balanced"), 2.0);
  EXPECT_EQ(decision.after, "plain");
  EXPECT_EQ(selector().decide(1009, views(2, 2.0, 1.0)).after, "balanced") << "from two views, an error is a guess";
  const KernelDecision none = selector().decide(1009, {});
  EXPECT_EQ(none.after, "balanced");
  EXPECT_TRUE(none.times_ms.empty());
  EXPECT_FALSE(none.reason.empty());
}

TEST(KernelSelector, ContinuesOnTheSameDeviceAndStartsOverOnAnother) {
  KernelSelector own = selector();
  own.decide(1009, views(8, 2.0, 1.0));
  const nlohmann::ordered_json state = own.to_json("A GPU");
  const auto restored = [&](KernelRule rule, const std::string& device) {
    KernelSelector other(std::move(rule));
    other.restore(state, device, "file");
    return other.kernel();
  };
  EXPECT_EQ(restored({"balanced", "plain"}, "A GPU"), "plain");
  EXPECT_EQ(restored({"balanced", "plain"}, "Another GPU"), "balanced");
  EXPECT_EQ(restored({"balanced", "third"}, "A GPU"), "balanced");
  EXPECT_EQ(restored({"plain", "balanced"}, "A GPU"), "plain") << "other kernels: the first of them";
  EXPECT_EQ(restored({"fixed", ""}, "A GPU"), "fixed");
  own.restore(nlohmann::ordered_json::object(), "A GPU", "file");
  EXPECT_EQ(own.kernel(), "balanced") << "of a training without a choice";
}

TEST(KernelSelector, RefusesADamagedState) {
  for (const char* text :
       {R"({"kernels": 3})", R"({"kernels": ["a"]})", R"({"kernels": ["a", 2], "kernel": "a"})",
        R"({"kernels": ["balanced", "plain"]})", R"({"kernels": ["balanced", "plain"], "kernel": 1})",
        R"({"kernels": ["balanced", "plain"], "kernel": "plain", "device": []})"}) {
    KernelSelector own = selector();
    EXPECT_TRUE(test::fails_with<InputError>({"file: invalid state"}, [&] {
      own.restore(nlohmann::ordered_json::parse(text), "A GPU", "file");
    })) << text;
  }
}

TEST(KernelSelector, LogsWhatItMeasured) {
  KernelDecision decision = selector().decide(1009, views(8, 2.0, 1.0));
  decision.cost_ms = 12;
  EXPECT_EQ(to_json(decision).dump(),
            R"({"views":8,"times_ms":{"balanced":2.0,"plain":1.0},"error_ms":0.0,"cost_ms":12.0,"before":"balanced",)"
            R"("after":"plain","reason":"plain takes 50.0 % less, standard error 0.0 %"})");
}

}  // namespace
}  // namespace b3dgs
