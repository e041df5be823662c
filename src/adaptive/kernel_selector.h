// Which of several kernels for one pass to use next: a state machine that is told iterations and times. It knows no
// clock, no device and no kernel but by name.
//
// A check compares the candidates view by view: for each view the ratio of two kernels' times, and of these ratios the
// median. Views differ far more from each other than two runs of one view do, so pairs say more than averages. A kernel
// counts as faster only where the median leads by more than the margin: a hundredth, or three standard errors of the
// median if those are more.
#pragma once

#include <map>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

namespace b3dgs {

enum class KernelPolicy {
  kPaper,     // the first candidate until a check finds it slower; then the fastest other one, for good
  kTracking,  // keeps checking and may go back, with hysteresis; checks thin out while nothing changes
  // As the paper says it, for comparisons with it: as kPaper, but with no check before the first step, at every
  // multiple of the interval whatever it costs, on all views, and without a margin.
  kPublished,
};

struct KernelSelectorOptions {
  KernelPolicy policy = KernelPolicy::kPaper;
  std::vector<std::string> candidates;  // the first is the one to start with; a single one is fixed
  std::string reference;                // what to use if every candidate is refused
  int interval = 1000;                  // iterations between two checks, or more if they cost too much
  double cost_share = 0.005;            // of the training time, that checks may take
};

/// Where a training stands before a step.
struct CheckMoment {
  int iteration = 0;     // of that step
  int n_steps_left = 0;  // with that step
  double step_ms = 0;    // what a step takes; 0: not known yet
  // Opacities were reset so recently that what a kernel takes now says little about the steps to come.
  bool is_after_reset = false;
};

/// One candidate as a check found it.
struct KernelMeasurement {
  std::string kernel;
  std::vector<double> ms;  // by view, the same views in the same order for all candidates
  std::string fault;       // why what it computes cannot be trusted; empty if it can
};

/// What measurements come to, by kernel. Times that are missing, zero or not finite do not count.
struct KernelTimes {
  std::map<std::string, double> times_ms;   // median over the views
  std::map<std::string, double> spread_ms;  // robust standard deviation over the views
  int views = 0;
};
KernelTimes summarize(const std::vector<KernelMeasurement>& measurements);

/// A check and what came of it.
struct KernelDecision : KernelTimes {
  int iteration = 0;
  std::string before, after;  // kernel in use
  std::string reason;
  std::vector<std::string> refused;  // by this check
  double cost_ms = 0;                // of the check itself
  double step_ms = 0;                // what a step took; 0: not known
  int next_check = 0;                // not before this iteration, as far as is known by now; 0: none comes
};

class KernelSelector {
 public:
  /// The names of `options` are different from each other.
  explicit KernelSelector(KernelSelectorOptions options);

  /// The kernel in use.
  const std::string& kernel() const { return kernel_; }

  const std::string& reference() const { return options_.reference; }

  /// What a check has to measure, the kernel in use first.
  std::vector<std::string> candidates() const;

  /// Whether to measure now. The first check comes before the very first step. The others come at multiples of the
  /// interval, or as soon after them as all checks so far and this one, if it costs what the last one did, are within
  /// their share of the training time so far; none whose cost is more than that share of the time that is left; and
  /// none just after an opacity reset. KernelPolicy::kPublished heeds the multiples alone.
  bool is_due(const CheckMoment& now) const;

  /// What a check may cost to be repeated after one interval; unlimited where no step's time is known or its cost does
  /// not matter.
  double budget_ms(double step_ms) const;

  /// No more checks: one candidate is left, or a policy that switches once has done so.
  bool is_finished() const;

  /// Whether the times so far leave no doubt: every candidate is ahead of the kernel in use, or behind it, by twice the
  /// margin. More views would cost time and change nothing.
  bool is_clear(const std::vector<KernelMeasurement>& measurements) const;

  /// Decides, and keeps the record. Times that are missing, zero or not finite do not count; with fewer than
  /// kMinViews pairs everything stays as it is.
  const KernelDecision& decide(const CheckMoment& now, const std::vector<KernelMeasurement>& measurements,
                               double cost_ms);

  const std::vector<KernelDecision>& history() const { return history_; }

  /// The whole state, and back. Options that have changed in between count: with another policy or interval the choice
  /// goes on from the kernel in use; with other candidates it starts anew, and only history and refusals stay. A single
  /// candidate is used whatever was found before.
  /// @throws InputError that begins with `place` if it is not what to_json() gives
  nlohmann::ordered_json to_json() const;
  void restore(const nlohmann::ordered_json& json, const std::string& place);

  static constexpr int kMinViews = 3;  // fewer say nothing about their spread

 private:
  struct Lead;
  /// @throws nlohmann::json::exception too
  void restore_checked(const nlohmann::ordered_json& json, const std::string& place);
  Lead lead_over_current(const KernelMeasurement& other, const KernelMeasurement& current) const;
  void refuse_faulty(const std::vector<KernelMeasurement>& measurements, KernelDecision& decision);
  void choose(const std::vector<KernelMeasurement>& measurements, KernelDecision& decision);
  void leave_refused(const std::vector<KernelMeasurement>& measurements, KernelDecision& decision);
  std::string settle_challenge(const std::string& challenger, const Lead& lead);
  bool is_affordable(double cost_ms, int n_steps, double step_ms) const;
  double cost_with_next_ms() const;  // of all checks and one more like the last
  int next_multiple() const;
  int earliest_check(double step_ms) const;
  bool is_candidate(const std::string& kernel) const;  // and not refused
  std::string first_trusted() const;

  KernelSelectorOptions options_;
  std::string kernel_;
  std::map<std::string, std::string> refused_;  // kernel: why
  int last_check_ = 0;                          // iteration; 0: none yet
  std::string challenger_;                      // tracking: was faster in the last check, not yet gone over to
  int back_off_ = 1;                            // tracking: intervals to the next check
  std::vector<KernelDecision> history_;
};

/// One line for the user where a check changes something, else "".
std::string describe_change(const KernelDecision& decision, bool is_final);

nlohmann::ordered_json to_json(const KernelTimes& times);
nlohmann::ordered_json to_json(const KernelDecision& decision);

}  // namespace b3dgs
