// Kernel selection with made-up times.
#include "adaptive/kernel_selector.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

#include "core/check.h"
#include "support/expect_error.h"

namespace b3dgs {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

KernelSelectorOptions options_of(KernelPolicy policy, std::vector<std::string> candidates = {"balanced", "standard"}) {
  return {policy, std::move(candidates), "plain", 1000};
}

/// Steps take 1 ms: a check of 5 ms fits into an interval.
CheckMoment at(int iteration) {
  return {iteration, 1.0};
}

/// Times on five views of very different cost, scaled by `ms`.
KernelMeasurement steady(const std::string& kernel, double ms) {
  return {kernel, {ms * 1.0, ms * 5.0, ms * 0.4, ms * 2.0, ms * 1.5}, ""};
}

/// Runs the checks that are due up to `last`; times are given by the iteration.
template <class Times>
std::vector<KernelDecision> run(KernelSelector& selector, int first, int last, Times&& times) {
  std::vector<KernelDecision> checks;
  for (int iteration = first; iteration <= last; ++iteration) {
    if (selector.is_due(at(iteration))) checks.push_back(selector.decide(at(iteration), times(iteration), 1.0));
  }
  return checks;
}

std::vector<int> iterations_of(const std::vector<KernelDecision>& checks) {
  std::vector<int> iterations;
  iterations.reserve(checks.size());
  for (const KernelDecision& check : checks) iterations.push_back(check.iteration);
  return iterations;
}

std::size_t count_changes(const std::vector<KernelDecision>& checks) {
  std::size_t n_changes = 0;
  for (const KernelDecision& check : checks) n_changes += check.before != check.after;
  return n_changes;
}

/// The balanced kernel takes 1 until `inflection`, then 2; the standard one 1.5.
auto inflection_at(int inflection) {
  return [=](int iteration) {
    return std::vector<KernelMeasurement>{steady("balanced", iteration < inflection ? 1.0 : 2.0),
                                          steady("standard", 1.5)};
  };
}

TEST(PaperPolicy, SwitchesAtTheFirstCheckAfterTheInflectionAndNeverChecksAgain) {
  KernelSelector selector(options_of(KernelPolicy::kPaper));
  EXPECT_EQ(selector.kernel(), "balanced");
  const std::vector<KernelDecision> checks = run(selector, 1, 9000, inflection_at(2300));
  ASSERT_EQ(iterations_of(checks), (std::vector<int>{1, 1000, 2000, 3000}));
  EXPECT_EQ(selector.kernel(), "standard");
  EXPECT_TRUE(selector.is_finished());
  EXPECT_EQ(checks[2].after, "balanced");
  EXPECT_EQ(checks[3].before, "balanced");
  EXPECT_EQ(checks[3].after, "standard");
}

TEST(PaperPolicy, SwitchesBeforeTheFirstStepIfTheLoadIsEven) {
  KernelSelector selector(options_of(KernelPolicy::kPaper));
  EXPECT_EQ(iterations_of(run(selector, 1, 5000, inflection_at(0))), (std::vector<int>{1}));
  EXPECT_EQ(selector.kernel(), "standard");
}

TEST(PaperPolicy, StaysAndKeepsCheckingIfThereIsNoInflection) {
  KernelSelector selector(options_of(KernelPolicy::kPaper));
  EXPECT_EQ(iterations_of(run(selector, 1, 4500, inflection_at(1 << 30))),
            (std::vector<int>{1, 1000, 2000, 3000, 4000}));
  EXPECT_EQ(selector.kernel(), "balanced");
  EXPECT_FALSE(selector.is_finished());
}

TEST(PaperPolicy, TakesTheFastestOfSeveral) {
  KernelSelector selector(options_of(KernelPolicy::kPaper, {"a", "b", "c", "d"}));
  selector.decide(at(1), {steady("a", 2), steady("b", 1.5), steady("c", 1.1), steady("d", 1.2)}, 0);
  EXPECT_EQ(selector.kernel(), "c");
}

TEST(PaperPolicy, DoesNotSwitchOnATie) {
  KernelSelector selector(options_of(KernelPolicy::kPaper));
  run(selector, 1, 3000, [](int) {
    return std::vector<KernelMeasurement>{steady("balanced", 1.0), steady("standard", 1.0)};
  });
  EXPECT_EQ(selector.kernel(), "balanced");
}

TEST(PaperPolicy, DoesNotSwitchForALeadWithinOnePercent) {
  KernelSelector selector(options_of(KernelPolicy::kPaper));
  selector.decide(at(1), {steady("balanced", 1.009), steady("standard", 1.0)}, 0);
  EXPECT_EQ(selector.kernel(), "balanced");
  const KernelDecision second = selector.decide(at(1000), {steady("balanced", 1.012), steady("standard", 1.0)}, 0);
  EXPECT_EQ(selector.kernel(), "standard") << second.reason;
}

TEST(PaperPolicy, DecidesNothingJustAfterAnOpacityReset) {
  CheckMoment after_reset = at(3001);
  after_reset.is_after_reset = true;
  for (const KernelPolicy policy : {KernelPolicy::kPaper, KernelPolicy::kTracking}) {
    KernelSelector selector(options_of(policy));
    selector.decide(at(1), {steady("balanced", 1), steady("standard", 1.5)}, 1);
    EXPECT_TRUE(selector.is_due(at(3001)));
    EXPECT_FALSE(selector.is_due(after_reset));
  }
}

TEST(PublishedPolicy, ChecksAtEveryMultipleWhateverItCostsAndSwitchesOnce) {
  KernelSelector selector(options_of(KernelPolicy::kPublished));
  std::vector<int> checked;
  for (int iteration = 1; iteration <= 9000; ++iteration) {
    const CheckMoment now{iteration, 1.0, iteration == 3000};
    if (!selector.is_due(now)) continue;
    selector.decide(now, inflection_at(2300)(iteration), 1e9);
    checked.push_back(iteration);
  }
  EXPECT_EQ(checked, (std::vector<int>{1000, 2000, 3000}))
      << "none before the first step, none delayed, none after the switch";
  EXPECT_EQ(selector.kernel(), "standard");
  KernelSelector read(options_of(KernelPolicy::kPublished));
  read.restore(nlohmann::ordered_json::parse(selector.to_json().dump()), "a.b3dgs");
  EXPECT_TRUE(read.is_finished());
}

TEST(PublishedPolicy, TakesAllViewsAndHasNoMargin) {
  KernelSelector selector(options_of(KernelPolicy::kPublished));
  EXPECT_FALSE(selector.is_clear({steady("balanced", 1), steady("standard", 9)}));
  EXPECT_TRUE(std::isinf(selector.budget_ms(1)));
  selector.decide(at(1000), {steady("balanced", 1), steady("standard", 1)}, 1);
  EXPECT_EQ(selector.kernel(), "balanced") << "not slower";
  const KernelDecision second = selector.decide(at(2000), {steady("balanced", 1.001), steady("standard", 1)}, 1);
  EXPECT_EQ(selector.kernel(), "standard") << second.reason;
}

TEST(Margin, GrowsWithTheScatterOfTheRatios) {
  // The median leads by 5 %, but views disagree by far more.
  KernelSelector selector(options_of(KernelPolicy::kPaper));
  selector.decide(at(1), {{"balanced", {1.05, 1.4, 0.8, 1.2, 0.9}, ""}, {"standard", {1, 1, 1, 1, 1}, ""}}, 0);
  EXPECT_EQ(selector.kernel(), "balanced");
  selector.decide(at(1000), {{"balanced", {1.05, 1.06, 1.04, 1.05, 1.05}, ""}, {"standard", {1, 1, 1, 1, 1}, ""}}, 0);
  EXPECT_EQ(selector.kernel(), "standard");
}

/// How often one check of five views selects the second kernel, with 3 % noise on every time.
double share_selected(double second_ms) {
  std::mt19937 random(5);
  std::normal_distribution<double> noise(0, 0.03);
  constexpr int kTrials = 4000;
  int n_selected = 0;
  for (int trial = 0; trial < kTrials; ++trial) {
    KernelSelector selector(options_of(KernelPolicy::kPaper));
    std::vector<KernelMeasurement> measured{steady("balanced", 1), steady("standard", second_ms)};
    for (KernelMeasurement& one : measured) {
      for (double& ms : one.ms) ms *= std::exp(noise(random));
    }
    selector.decide(at(1), measured, 0);
    n_selected += selector.kernel() == "standard";
  }
  return static_cast<double>(n_selected) / kTrials;
}

TEST(Margin, NoiseRarelySelectsASlowerKernel) {
  EXPECT_LT(share_selected(1.0), 0.08) << "equal kernels";
  EXPECT_LT(share_selected(1.05), 0.01);
  EXPECT_GT(share_selected(0.8), 0.95) << "but a clear lead is found";
}

TEST(Margin, ANoisyLeaderDoesNotHideACertainOne) {
  KernelSelector selector(options_of(KernelPolicy::kPaper, {"a", "b", "c"}));
  const KernelDecision check = selector.decide(
      at(1), {{"a", {1, 1, 1, 1, 1}, ""}, {"b", {.5, .8, 1.1, .82, .95}, ""}, {"c", {.85, .85, .86, .85, .84}, ""}}, 0);
  EXPECT_EQ(selector.kernel(), "c") << check.reason;

  std::mt19937 random(11);
  std::normal_distribution<double> noise(0, 1);
  std::map<std::string, int> taken;
  constexpr int kTrials = 4000;
  for (int trial = 0; trial < kTrials; ++trial) {
    KernelSelector own(options_of(KernelPolicy::kPaper, {"a", "noisy", "certain"}));
    std::vector<KernelMeasurement> measured{steady("a", 1), steady("noisy", 0.95), steady("certain", 0.85)};
    for (double& ms : measured[1].ms) ms *= std::exp(0.3 * noise(random));
    for (double& ms : measured[2].ms) ms *= std::exp(0.01 * noise(random));
    own.decide(at(1), measured, 0);
    ++taken[own.kernel()];
  }
  EXPECT_GT(taken["certain"], 0.9 * kTrials);
  EXPECT_EQ(taken["a"], 0);
}

TEST(Margin, IfNoneIsCertainTheReasonNamesTheLargestLead) {
  KernelSelector selector(options_of(KernelPolicy::kPaper, {"a", "b", "c"}));
  const KernelDecision check = selector.decide(at(1), {steady("a", 1), steady("b", 0.999), steady("c", 0.995)}, 0);
  EXPECT_EQ(selector.kernel(), "a");
  EXPECT_NE(check.reason.find("c takes 0.5 % less time than a"), std::string::npos);
}

TEST(Margin, AnInterruptedRunHasNoInfluence) {
  KernelSelector selector(options_of(KernelPolicy::kPaper));
  KernelMeasurement standard = steady("standard", 1.0);
  standard.ms[2] *= 40;
  selector.decide(at(1), {steady("balanced", 1.3), standard}, 0);
  EXPECT_EQ(selector.kernel(), "standard");
}

TEST(Conclusive, IsADecisionThatMoreViewsWouldNotChange) {
  const KernelSelector selector(options_of(KernelPolicy::kPaper, {"a", "b", "c"}));
  EXPECT_TRUE(selector.is_clear({steady("a", 1), steady("b", 1.1), steady("c", 0.5)}));
  EXPECT_FALSE(selector.is_clear({steady("a", 1), steady("b", 1.1), steady("c", 0.99)}));
  EXPECT_FALSE(selector.is_clear({steady("a", 1), {"b", {2.0, 10.0}, ""}})) << "two views";
  EXPECT_FALSE(selector.is_clear({steady("a", 1), {"b", {1.4, 5.0, 0.8, 2.3, 1.4}, ""}})) << "views disagree";
  EXPECT_FALSE(selector.is_clear({steady("b", 1)})) << "nothing of the kernel in use";
  EXPECT_TRUE(selector.is_clear({steady("a", 1), steady("b", 2), {"c", {}, "wrong"}}));
}

TEST(Times, ThatAreInvalidAreIgnored) {
  KernelSelector selector(options_of(KernelPolicy::kPaper));
  for (const double wrong : {kNan, 0.0, -1.0, std::numeric_limits<double>::infinity()}) {
    // Two views are left: too few.
    const KernelDecision check =
        selector.decide(at(1), {steady("balanced", 3), {"standard", {wrong, wrong, wrong, 2.0, 1.5}, ""}}, 0);
    EXPECT_EQ(selector.kernel(), "balanced");
    EXPECT_NE(check.reason.find("valid times"), std::string::npos);
  }
  const KernelDecision check =
      selector.decide(at(1000), {steady("balanced", 3), {"standard", {kNan, 5.0, 0.0, 2.0, 1.5}, ""}}, 0);
  EXPECT_EQ(selector.kernel(), "standard") << "three views are enough";
  EXPECT_EQ(check.times_ms.at("standard"), 2.0);
  EXPECT_EQ(check.times_ms.count("balanced"), 1u);
}

TEST(Times, MayBeMissing) {
  KernelSelector selector(options_of(KernelPolicy::kTracking));
  selector.decide(at(1), {}, 0);
  selector.decide(at(1000), {steady("standard", 1)}, 0);
  selector.decide(at(2000), {{"balanced", {}, ""}, {"standard", {}, ""}}, 0);
  EXPECT_EQ(selector.kernel(), "balanced");
  EXPECT_FALSE(selector.is_due(at(2001)));
}

TEST(TrackingPolicy, ChecksAtEveryIntervalAndSwitchesBackWhenAResetMakesTheLoadUneven) {
  KernelSelector selector(options_of(KernelPolicy::kTracking));
  const std::vector<KernelDecision> checks = run(selector, 1, 8000, [](int iteration) {
    const bool uneven = iteration < 1500 || (iteration >= 3000 && iteration < 5500);
    return std::vector<KernelMeasurement>{steady("balanced", uneven ? 1.0 : 2.0), steady("standard", 1.5)};
  });
  EXPECT_EQ(iterations_of(checks), (std::vector<int>{1, 1000, 2000, 3000, 4000, 5000, 6000, 7000, 8000}));
  std::vector<int> changed;
  for (const KernelDecision& check : checks) {
    if (check.before != check.after) changed.push_back(check.iteration);
  }
  EXPECT_EQ(changed, (std::vector<int>{2000, 3000, 6000})) << "switches, switches back, switches again";
  EXPECT_EQ(selector.kernel(), "standard");
  EXPECT_FALSE(selector.is_finished());
}

TEST(TrackingPolicy, RarelySwitchesOnNoise) {
  std::mt19937 random(7);
  std::normal_distribution<double> noise(0, 0.02);
  KernelSelector selector(options_of(KernelPolicy::kTracking));
  const std::vector<KernelDecision> checks = run(selector, 1, 300000, [&](int) {
    std::vector<KernelMeasurement> measured{steady("balanced", 1), steady("standard", 1)};
    for (KernelMeasurement& one : measured) {
      for (double& ms : one.ms) ms *= std::exp(noise(random));
    }
    return measured;
  });
  EXPECT_EQ(checks.size(), 301u);
  EXPECT_LE(count_changes(checks), 24u) << "8 % of the checks, as in Margin.NoiseRarelySelectsASlowerKernel";
}

TEST(DisabledKernel, StaysDisabled) {
  KernelSelector selector(options_of(KernelPolicy::kTracking, {"a", "b", "c"}));
  const KernelDecision check =
      selector.decide(at(1), {steady("a", 1.0), {"b", {}, "its image differs"}, steady("c", 1.2)}, 0);
  EXPECT_EQ(selector.kernel(), "a");
  EXPECT_EQ(selector.candidates(), (std::vector<std::string>{"a", "c"}));
  EXPECT_EQ(check.disabled, (std::vector<std::string>{"b"}));
  EXPECT_NE(check.reason.find("b is disabled: its image differs"), std::string::npos);
  selector.decide(at(2000), {steady("a", 9.0), steady("b", 0.1), steady("c", 8.0)}, 0);
  EXPECT_EQ(selector.kernel(), "c") << "b was disabled before, whatever its times";
}

TEST(DisabledKernel, InUseIsReplacedByTheFastestThatAgrees) {
  KernelSelector selector(options_of(KernelPolicy::kTracking, {"a", "b", "c"}));
  selector.decide(at(1), {{"a", {}, "wrong"}, steady("b", 1.4), steady("c", 1.2)}, 0);
  EXPECT_EQ(selector.kernel(), "c");
  EXPECT_EQ(selector.candidates(), (std::vector<std::string>{"c", "b"}));
}

TEST(DisabledKernel, OneOfTwoEndsTheChecks) {
  for (const KernelPolicy policy : {KernelPolicy::kPaper, KernelPolicy::kTracking}) {
    KernelSelector first(options_of(policy)), second(options_of(policy));
    first.decide(at(1), {{"balanced", {}, "wrong"}, {"standard", {}, ""}}, 0);
    EXPECT_EQ(first.kernel(), "standard");
    EXPECT_TRUE(first.is_finished());
    second.decide(at(1), {{"balanced", {}, ""}, {"standard", {}, "wrong"}}, 0);
    EXPECT_EQ(second.kernel(), "balanced");
    EXPECT_TRUE(second.is_finished());
  }
}

TEST(DisabledKernel, AllOfThemLeaveTheReference) {
  KernelSelector selector(options_of(KernelPolicy::kPaper));
  selector.decide(at(1), {{"balanced", {}, "wrong"}, {"standard", {}, "wrong too"}}, 0);
  EXPECT_EQ(selector.kernel(), "plain");
  EXPECT_FALSE(selector.is_due(at(1000)));
}

TEST(Cost, DelaysTheNextCheckUntilItIsWithinItsShare) {
  KernelSelector selector(options_of(KernelPolicy::kPaper));
  const std::vector<KernelMeasurement> measured{steady("balanced", 1), steady("standard", 1.5)};
  selector.decide({1, 0}, measured, 6);
  EXPECT_FALSE(selector.is_due({1000, 1.0}));
  EXPECT_FALSE(selector.is_due({2400, 1.0}));
  EXPECT_TRUE(selector.is_due({2401, 1.0})) << "12 ms for two are 0.5 % of 2400 steps of 1 ms";
  EXPECT_TRUE(selector.is_due({1000, 2.5})) << "steps have become longer";
  EXPECT_FALSE(selector.is_due({999, 100})) << "never before the interval is over";
  EXPECT_FALSE(selector.is_due({5000, 0})) << "nothing is known of the steps";
  EXPECT_EQ(selector.decide({2401, 2.0}, measured, 31).step_ms, 2.0);
  EXPECT_FALSE(selector.is_due({6800, 2.0}));
  EXPECT_TRUE(selector.is_due({6801, 2.0})) << "6, 31 and again 31 ms";
}

TEST(Cost, OfAllChecksStaysWithinTheShareWhateverTheInterval) {
  for (const int interval : {1, 11, 1000}) {
    for (const KernelPolicy policy : {KernelPolicy::kPaper, KernelPolicy::kTracking}) {
      KernelSelectorOptions options = options_of(policy);
      options.interval = interval;
      KernelSelector selector(options);
      constexpr int kIterations = 30000;
      constexpr double kStepMs = 2, kCheckMs = 13;
      int n_checks = 0;
      for (int iteration = 1; iteration <= kIterations; ++iteration) {
        const CheckMoment now{iteration, iteration == 1 ? 0 : kStepMs};
        if (!selector.is_due(now)) continue;
        selector.decide(now, inflection_at(1 << 30)(iteration), kCheckMs);
        ++n_checks;
      }
      EXPECT_GT(n_checks, 5);
      EXPECT_LE(kCheckMs * n_checks, 0.005 * kIterations * kStepMs) << "interval " << interval;
    }
  }
}

TEST(Cost, AllowsWhatCanBeRepeatedAfterAnInterval) {
  const KernelSelector selector(options_of(KernelPolicy::kPaper));
  EXPECT_DOUBLE_EQ(selector.budget_ms(3), 15);
  EXPECT_EQ(selector.budget_ms(0), std::numeric_limits<double>::infinity());
}

TEST(FixedKernel, IsNeverChecked) {
  KernelSelector selector(options_of(KernelPolicy::kTracking, {"standard"}));
  EXPECT_EQ(selector.kernel(), "standard");
  for (const int iteration : {1, 1000, 2000}) EXPECT_FALSE(selector.is_due(at(iteration)));
}

TEST(Selector, RejectsDuplicateCandidates) {
  EXPECT_TRUE(test::fails_with<LogicError>({"duplicates", "[\"a\",\"a\"]"}, [] {
    KernelSelector(options_of(KernelPolicy::kPaper, {"a", "a"}));
  }));
}

/// As after a round trip through a checkpoint.
KernelSelector restored(const KernelSelector& selector, const KernelSelectorOptions& options) {
  KernelSelector copy(options);
  copy.restore(nlohmann::ordered_json::parse(selector.to_json().dump()), "a.b3dgs");
  return copy;
}

TEST(Restored, ContinuesLikeOneThatNeverStopped) {
  for (const KernelPolicy policy : {KernelPolicy::kPaper, KernelPolicy::kTracking}) {
    const auto times = [](int iteration) {
      const bool uneven = iteration < 2600 || (iteration > 7000 && iteration < 9000);
      return std::vector<KernelMeasurement>{steady("balanced", uneven ? 1.46 : 1.55), steady("standard", 1.5)};
    };
    KernelSelector whole(options_of(policy));
    run(whole, 1, 20000, times);
    for (const int stop : {1, 700, 1000, 3400, 5000, 12345}) {  // in the middle of an interval, and at a check
      KernelSelector first(options_of(policy));
      run(first, 1, stop, times);
      KernelSelector second = restored(first, options_of(policy));
      EXPECT_EQ(second.to_json(), first.to_json());
      run(second, stop + 1, 20000, times);
      EXPECT_EQ(second.to_json(), whole.to_json()) << "stopped at " << stop;
    }
  }
}

TEST(Restored, KnowsWhatTheLastCheckCost) {
  KernelSelector selector(options_of(KernelPolicy::kPaper));
  selector.decide(at(1), inflection_at(1 << 30)(1), 20);
  const KernelSelector copy = restored(selector, options_of(KernelPolicy::kPaper));
  EXPECT_FALSE(copy.is_due(at(8000)));
  EXPECT_TRUE(copy.is_due(at(8001))) << "20 ms and as much again are 0.5 % of 8000 steps of 1 ms";
}

/// As commit 8dc6c33 wrote it, after checks before iterations 1 and 1000.
constexpr const char* kOldState = R"({
  "policy": "tracking", "candidates": ["balanced", "standard"], "interval": 1000, "kernel": "standard",
  "refused": {}, "last_check": 1000, "challenger": "balanced", "back_off": 2,
  "history": [
    {"iteration": 1, "times_ms": {"balanced": 1.0, "standard": 1.5}, "spread_ms": {"balanced": 0.1, "standard": 0.1},
     "views": 3, "before": "balanced", "after": "balanced", "reason": "r", "cost_ms": 6.0},
    {"iteration": 1000, "times_ms": {"balanced": 2.0, "standard": 1.5}, "spread_ms": {"balanced": 0.1, "standard": 0.1},
     "views": 3, "before": "balanced", "after": "standard", "reason": "r", "cost_ms": 7.0, "step_ms": 9.0,
     "next_check": 3000}]})";

TEST(Restored, FromAnOldCheckpointWithMoreKeys) {
  KernelSelector selector(options_of(KernelPolicy::kTracking));
  selector.restore(nlohmann::ordered_json::parse(kOldState), "a.b3dgs");
  EXPECT_EQ(selector.kernel(), "standard");
  EXPECT_FALSE(selector.is_due(at(4000)));
  EXPECT_TRUE(selector.is_due(at(4001))) << "6, 7 and again 7 ms are 0.5 % of 4000 steps of 1 ms";
  EXPECT_FALSE(selector.is_due({1999, 100}));
  EXPECT_TRUE(selector.is_due({2000, 100}));
}

TEST(Restored, NeverRepeatsAFinishedDecision) {
  KernelSelector selector(options_of(KernelPolicy::kPaper));
  run(selector, 1, 3000, inflection_at(1500));
  KernelSelector copy = restored(selector, options_of(KernelPolicy::kPaper));
  EXPECT_EQ(copy.kernel(), "standard");
  for (int iteration = 3001; iteration <= 9000; ++iteration) ASSERT_FALSE(copy.is_due(at(iteration)));
}

TEST(Restored, WithAnotherPolicyContinuesFromTheKernelInUse) {
  KernelSelector selector(options_of(KernelPolicy::kPaper));
  run(selector, 1, 3000, inflection_at(1500));
  KernelSelector tracking = restored(selector, options_of(KernelPolicy::kTracking));
  EXPECT_EQ(tracking.kernel(), "standard");
  EXPECT_TRUE(tracking.is_due(at(3001))) << "its last check is long ago";
  tracking.decide(at(3001), inflection_at(1 << 30)(0), 0);
  EXPECT_EQ(tracking.kernel(), "balanced");
  EXPECT_FALSE(restored(tracking, options_of(KernelPolicy::kPaper)).is_finished());
}

TEST(Restored, WithAnotherIntervalUsesThatOne) {
  KernelSelector selector(options_of(KernelPolicy::kPaper));
  run(selector, 1, 1400, inflection_at(1 << 30));
  KernelSelectorOptions options = options_of(KernelPolicy::kPaper);
  options.interval = 300;
  const KernelSelector copy = restored(selector, options);
  EXPECT_FALSE(copy.is_due(at(1199)));
  EXPECT_TRUE(copy.is_due(at(1401)));
}

TEST(Restored, WithOtherCandidatesStartsOverAndKeepsDisabledKernels) {
  KernelSelector selector(options_of(KernelPolicy::kPaper, {"a", "b"}));
  selector.decide(at(1), {{"a", {}, "wrong"}, steady("b", 1)}, 0);
  const KernelSelector copy = restored(selector, options_of(KernelPolicy::kPaper, {"a", "c", "d"}));
  EXPECT_EQ(copy.kernel(), "c");
  EXPECT_EQ(copy.candidates(), (std::vector<std::string>{"c", "d"}));
  const KernelSelector fixed = restored(selector, options_of(KernelPolicy::kPaper, {"a"}));
  EXPECT_EQ(fixed.kernel(), "a") << "a kernel that is asked for by name is used";
  const KernelSelector anew = restored(fixed, options_of(KernelPolicy::kTracking, {"b", "c"}));
  EXPECT_EQ(anew.kernel(), "b");
  EXPECT_TRUE(anew.is_due(at(17)));
}

TEST(Restored, FromInvalidJsonIsAnError) {
  KernelSelector selector(options_of(KernelPolicy::kPaper));
  EXPECT_THROW(selector.restore({{"kernel", "standard"}}, "a.b3dgs"), InputError);
  EXPECT_THROW(selector.restore({{"history", {{{"iteration", "one"}}}}}, "a.b3dgs"), InputError);
  nlohmann::ordered_json json = selector.to_json();
  for (const auto& [key, value] : {std::pair<const char*, nlohmann::ordered_json>{"last_check", 4294967296},
                                   {"last_check", -1},
                                   {"history", {{{"cost_ms", -1}}}},
                                   {"history", "none"}}) {
    nlohmann::ordered_json changed = json;
    changed[key] = value;
    EXPECT_THROW(selector.restore(changed, "a.b3dgs"), InputError) << key << " " << value;
  }
  EXPECT_EQ(selector.kernel(), "balanced");
}

TEST(Restored, AtTheLargestIterationHasNoNextCheck) {
  KernelSelector selector(options_of(KernelPolicy::kTracking));
  selector.decide(at(1), {steady("balanced", 2), steady("standard", 2)}, 0);
  nlohmann::ordered_json json = selector.to_json();
  json["last_check"] = std::numeric_limits<int>::max();
  selector.restore(json, "a.b3dgs");
  EXPECT_FALSE(selector.is_due(at(std::numeric_limits<int>::max() - 1)));
}

/// The line for the user after a check.
std::string message_of(KernelSelector& selector, int iteration, const std::vector<KernelMeasurement>& measured) {
  return selector.decide(at(iteration), measured, 0).message;
}

TEST(Message, SaysWhatChangedAndTheTimes) {
  const KernelMeasurement balanced{"balanced", {1.24, 1.25, 1.23}, ""}, standard{"standard", {1.02, 1.03, 1.01}, ""};
  KernelSelector paper(options_of(KernelPolicy::kPaper)), tracking(options_of(KernelPolicy::kTracking));
  EXPECT_EQ(message_of(paper, 2000, {balanced, standard}),
            "iteration 2000: balanced 1.24 ms, standard 1.02 ms: using standard, permanently");
  EXPECT_EQ(message_of(tracking, 2000, {balanced, standard}),
            "iteration 2000: balanced 1.24 ms, standard 1.02 ms: using standard, until the next check");
  EXPECT_EQ(message_of(tracking, 3000, {balanced, standard}), "");
  const std::string refusal = message_of(tracking, 4000, {{"balanced", {}, ""}, {"standard", {}, "wrong"}});
  EXPECT_NE(refusal.find("standard is disabled: wrong"), std::string::npos) << refusal;
  EXPECT_NE(refusal.find("using balanced, permanently"), std::string::npos) << refusal;
}

}  // namespace
}  // namespace b3dgs
