// Decides which of two kernels blends the training views, by the rule of Balanced 3DGS (arXiv 2412.17378): training
// starts with the balanced kernel, and at every interval both kernels blend the same views and are timed. This is a
// state machine over iterations and times. It has no clock and no device, and knows kernels only by name.
#pragma once

#include <map>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

namespace b3dgs {

enum class KernelPolicy {
  kAdaptive,   // switches whenever the other kernel is clearly faster, also back
  kPublished,  // as in the paper: once, at the first check after an interval that finds the second kernel faster
  kFixed,      // times are only logged
};

struct KernelRule {
  std::string first, second;  // training starts with `first`; an empty `second` means that there is no choice
  KernelPolicy policy = KernelPolicy::kAdaptive;
  int interval = 1000;  // iterations, at least 1
};

/// Times of one view, ms.
struct ViewTimes {
  double in_use_ms = 0, other_ms = 0;
};

/// The result of a check.
struct KernelDecision {
  int iteration = 0;  // first iteration after the check
  int views = 0;
  std::map<std::string, double> times_ms;  // mean over the views
  double error_ms = 0;                     // standard error of the mean difference
  double cost_ms = 0;                      // time that the check added to training
  std::string before, after;               // kernel in use
  std::string reason;
  std::string message;  // a line for the user if the kernel changes, else empty
};

class KernelSelector {
 public:
  /// Views of a check, or fewer if the interval is shorter. The paper's balanced kernel, timed after the switch, may
  /// take a quarter of a step. With five views, checks still cost at most 0.3 % of the training time
  /// (docs/lab/kernels.md).
  static constexpr int kViews = 5;
  static constexpr int kLoggedViews = 2;  // views of a check after which the kernel cannot change
  static constexpr int kMinViews = 3;     // with fewer, kAdaptive does not decide

  /// @throws LogicError if the rule does not fit
  explicit KernelSelector(KernelRule rule);

  /// Returns the kernel in use.
  const std::string& kernel() const { return is_second_ ? rule_.second : rule_.first; }
  const std::string& other() const { return is_second_ ? rule_.first : rule_.second; }

  /// Returns the number of the check that the view of this iteration belongs to, counted from 0, or -1 if there is
  /// none. A check takes the first views of the training and the first after each multiple of the interval.
  int check_of(int iteration) const;

  /// Decides by the sums of both kernels' times over the views. Switches to the other kernel if its lead exceeds 1 % of
  /// the sum and three standard errors of the paired differences. kPublished switches for any lead, but not at the
  /// check at the start of the training. Views without valid times are skipped.
  KernelDecision decide(int next_iteration, std::vector<ViewTimes> views);

  /// State for checkpoints. restore() starts over if `json` is from another device or for other kernels.
  /// @throws InputError that starts with `place` if `json` was not written by to_json()
  nlohmann::ordered_json to_json(const std::string& device) const;
  void restore(const nlohmann::ordered_json& json, const std::string& device, const std::string& place);

 private:
  /// Returns whether times are only logged.
  bool is_final() const {
    return rule_.policy == KernelPolicy::kFixed || (rule_.policy == KernelPolicy::kPublished && is_second_);
  }

  KernelRule rule_;
  bool is_second_ = false;
};

/// Returns the fields of the log's "kernel_check" lines.
nlohmann::ordered_json to_json(const KernelDecision& decision);

}  // namespace b3dgs
