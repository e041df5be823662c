// Results of configurations compared: whether a difference is more than chance (paired differences over seeds), time
// saved, what balancing saves, and what each has reached at its end.
#pragma once

#include <cstddef>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "compare/compare_config.h"
#include "report/train_log_reader.h"

namespace b3dgs {

/// Mean and range over seeds.
struct Spread {
  double mean = 0, min = 0, max = 0;
  int n = 0;
  double range() const { return max - min; }
};

/// nullopt if `values` is empty.
std::optional<Spread> spread_of(const std::vector<double>& values);

/// What the runs allow to say. kUnclear: the difference may be chance.
enum class Finding { kUnclear, kEqual, kDiffers };

struct EffectLimits {
  double floor = 0;     // several seeds: a smaller mean difference is not called one, however sure it is
  double one_seed = 0;  // one seed: a smaller difference may be chance
};

/// 0.1 dB is 2.3 % of the squared error; docs/recipes.md trusts no smaller effect. With one seed: trainings of the same
/// options have differed by 1 dB on `fox`.
inline constexpr EffectLimits kPsnrLimits{0.1, 1};
/// Runs in turns on one machine differ by 1 to 3 %. With one seed, the difference of two such runs has a standard
/// deviation of up to 3 % x sqrt(2), so that 10 % are exceeded by chance in 2 of 100 comparisons at most.
inline constexpr EffectLimits kTimeLimits{0.01, 0.1};

/// The difference in runs with the same seeds, one value for each seed.
struct Effect : Spread {
  std::optional<double> margin;  // half of the 95 % interval of the mean (Student's t); empty with one seed
  double limit = 0;              // of EffectLimits, the one that applies
  Finding finding = Finding::kUnclear;

  bool differs() const { return finding == Finding::kDiffers; }
  double low() const { return mean - margin.value_or(0); }
  double high() const { return mean + margin.value_or(0); }
};

/// Several seeds: kDiffers if the 95 % interval excludes 0 and the mean is at least the floor, kEqual if the interval
/// lies within the floor on both sides of 0. One seed: kDiffers above the limit, never kEqual. nullopt without values.
std::optional<Effect> effect_of(const std::vector<double>& differences, const EffectLimits& limits);

/// What one seed can say if the baseline was trained twice, with the difference `noise`: it is one difference of
/// equals, which another one exceeds t(1) = 12.7 times in 5 of 100 comparisons.
double limit_with_noise(double noise);

/// The limits for shares of the training time; `noise` is the share by which two runs of the baseline differ.
EffectLimits time_limits(const std::optional<double>& noise);

/// "differs", "equal" or "unclear"; `differs` says it otherwise.
std::string finding_word(const Effect& effect, const std::string& differs = "differs");
/// "faster", "slower", "equal" or "unclear".
std::string time_word(const Effect& saved);

/// "10.1 to 14.9 %", of a share; "" with one seed.
std::string interval_text(const Effect& share);

// How much training time one run saved against another.

/// (before_s - after_s) / before_s; negative if time was lost.
double saved_share(double before_s, double after_s);

/// Training time up to `iteration`, s, linearly interpolated between log lines; constant after the last line.
double elapsed_at(const TrainHistory& history, double iteration);

/// Iteration of the first check that switched to another forward kernel. The Balanced3DGS paper calls it the
/// inflection point, and so do the keys of compare.json.
std::optional<int> first_kernel_switch(const TrainHistory& history);

/// Iterations that ran with a load-balanced forward kernel, or those that ran with any other, and the time that both
/// runs took for them.
struct KernelPart {
  std::set<std::string> kernels;
  int iterations = 0;
  double baseline_s = 0, ours_s = 0;
};

/// Two runs of one configuration with the same seed.
struct RepeatedRun {
  const TrainHistory &first, &second;
};

/// Relative difference between the times of two runs of the same configuration and seed: |first - second| / first.
struct RunToRunVariation {
  std::optional<double> overall, before, after;  // before and after the kernel switch of the run it is shown with
};

/// Share of the baseline's time that was saved, (baseline - ours) / baseline, over the iterations that both runs have
/// completed.
struct TimeSaved {
  int until = 0;  // iteration
  double baseline_s = 0, ours_s = 0;
  std::optional<int> switch_iteration;
  std::optional<double> before, after;  // the switch; empty without one, `before` also if it is at the first iteration
  double overall = 0;
  KernelPart balanced, others;  // by the kernel that `ours` used; both empty if its log does not name kernels
  RunToRunVariation noise;      // over the same iterations; empty without a repeated run
};

/// nullopt if one of the two has no log line yet.
std::optional<TimeSaved> time_saved(const TrainHistory& baseline, const TrainHistory& ours,
                                    const RepeatedRun* repeated = nullptr);

// The time that load balancing alone saves: a configuration with load-balanced forward kernels against configurations
// that differ from it only in the forward kernel.

/// Splits the time saved by a load-balanced configuration (a balanced kernel, or a choice that includes one) in two:
/// from naive to the fastest kernel without load balancing, and from there to the balanced configuration.
struct BalancingGain {
  std::string name, naive, unbalanced;  // configurations; `unbalanced` has the fastest kernel without balancing
  double ours_s = 0, naive_s = 0, unbalanced_s = 0;  // means over seeds
  Effect to_unbalanced;                              // saved by `unbalanced`, share of naive's time
  Effect balancing;                                  // saved by load balancing, share of `unbalanced`'s time
  Effect whole;                                      // saved in total, share of naive's time
};

/// For configurations[index], over the first done_by_seed[i] iterations of seed i. `noise`: see time_limits(). nullopt
/// if the configuration has no balanced kernel, or if a kernel without load balancing was not trained with the same
/// other options.
std::optional<BalancingGain> balancing_gain(const std::vector<ConfigurationHistory>& configurations, std::size_t index,
                                            const std::vector<int>& done_by_seed, const std::optional<double>& noise);

/// Kernels without load balancing for which no configuration differs from `ours` only in the forward kernel.
std::vector<std::string> missing_unbalanced_kernels(const std::vector<ConfigurationHistory>& configurations,
                                                    const TrainConfig& ours);

/// Whether the forward kernel is load-balanced, or chosen from candidates that include a load-balanced one.
bool may_balance(const TrainConfig& config);

/// Whether the two are the comparison in the Balanced3DGS paper (arXiv:2412.17378): naive against the choice between
/// combined and shared-memory, both with the backward pass of the original 3DGS trainer (per-pixel).
bool is_paper_pair(const TrainConfig& baseline, const TrainConfig& ours);

// What each configuration has reached at the end of its own training, however long that is: time, quality, size.

struct FinalResult {
  std::string name;
  int iterations = 0;             // of the configuration
  int n_complete = 0;             // seeds that have been trained to the end; those below are over these
  std::optional<Spread> seconds;  // training time
  std::optional<Spread> count;    // Gaussians
  std::optional<Spread> psnr, ssim;
  std::optional<Effect> psnr_gained;  // compared with the first, over the seeds that both have trained to the end
};

std::vector<FinalResult> final_results(const std::vector<ConfigurationHistory>& configurations);

/// Whether all configurations train for the same number of iterations.
bool have_equal_lengths(const std::vector<FinalResult>& results);

/// Lines for standard output with aligned columns, the first to the left.
std::string text_table(const std::vector<std::vector<std::string>>& rows);

/// The same for results.
std::string results_table(const std::vector<FinalResult>& results);

/// "inria 38.2 s, 28.90 dB, 931,000 Gaussians; fast 4.9 s, ..."; what is not known is left out.
std::string describe_results(const std::vector<FinalResult>& results);

}  // namespace b3dgs
