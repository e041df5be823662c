// Decides which of several kernels a pass uses: a state machine over iterations and times. It knows neither clock nor
// device, and kernels only by name.
//
// A timing check compares the candidates view by view: it takes the median over the views of the ratio of two kernels'
// times. Views differ far more from each other than two runs on the same view, so pairs are more precise than averages.
// A kernel counts as faster only if its median lead exceeds the margin: 1 %, or three standard errors of the median if
// that is more.
#pragma once

#include <map>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

namespace b3dgs {

enum class KernelPolicy {
  kPaper,     // the first candidate until a check finds it slower; then switches to the fastest one, permanently
  kTracking,  // keeps checking and may switch back
  // Exactly as in the paper, for comparison: like kPaper, but without a check before the first step, at every multiple
  // of the interval whatever it costs, on all views, and without a margin.
  kPublished,
};

struct KernelSelectorOptions {
  KernelPolicy policy = KernelPolicy::kPaper;
  std::vector<std::string> candidates;  // training starts with the first; a single one is fixed
  std::string reference;                // used if every candidate is disabled
  int interval = 1000;                  // iterations between two checks; more if they would cost too much
  double cost_share = 0.005;            // share of the training time that checks may take
};

/// The situation before a step.
struct CheckMoment {
  int iteration = 0;   // of that step
  double step_ms = 0;  // duration of a step; 0 = not known yet
  // Opacities were reset so recently that times measured now say little about later steps.
  bool is_after_reset = false;
};

/// Times of one candidate in a check.
struct KernelMeasurement {
  std::string kernel;
  std::vector<double> ms;  // per view; the same views in the same order for all candidates
  std::string fault;       // how its result differs from that of the reference; empty if they agree
};

/// Summary of measurements, by kernel. Times that are missing, zero or not finite are ignored.
struct KernelTimes {
  std::string pass;                         // "forward" or "backward"
  std::map<std::string, double> times_ms;   // median over the views
  std::map<std::string, double> spread_ms;  // robust standard deviation over the views
  int views = 0;
};
KernelTimes summarize(const std::vector<KernelMeasurement>& measurements);

/// A check and its outcome.
struct KernelDecision : KernelTimes {
  int iteration = 0;
  std::string before, after;  // kernel in use
  std::string reason;
  std::vector<std::string> disabled;  // by this check (JSON key "refused")
  double cost_ms = 0;                 // of the check itself
  double step_ms = 0;                 // duration of a step; 0 = not known
  double warm_up_ms = 0;              // before the first check of a pass; not part of the cost
  std::string message;                // a line for the user if something changed, else empty
};

class KernelSelector {
 public:
  /// The candidates must have different names.
  explicit KernelSelector(KernelSelectorOptions options);

  /// The kernel in use.
  const std::string& kernel() const { return kernel_; }

  const std::string& reference() const { return options_.reference; }

  /// The kernels that a check has to time; the kernel in use first.
  std::vector<std::string> candidates() const;

  /// Whether a check is due. The first one comes before the very first step. Later ones come at multiples of the
  /// interval, or as soon afterwards as all checks so far plus one more like the last cost at most their share of the
  /// training time so far. There is none just after an opacity reset. KernelPolicy::kPublished only follows the
  /// multiples of the interval.
  bool is_due(const CheckMoment& now) const;

  /// The most that a check may cost if it is to be repeated after one interval, ms; infinite if the duration of a step
  /// is not known or costs are ignored.
  double budget_ms(double step_ms) const;

  /// No more checks: one candidate is left, or a policy that switches only once has done so.
  bool is_finished() const;

  /// Whether the times are conclusive: every candidate is faster or slower than the kernel in use by more than twice
  /// the margin, so that more views would not change the decision.
  bool is_clear(const std::vector<KernelMeasurement>& measurements) const;

  /// With fewer than kMinViews pairs of valid times nothing changes.
  KernelDecision decide(const CheckMoment& now, const std::vector<KernelMeasurement>& measurements, double cost_ms);

  /// Saves and restores the state. The current options apply: with another policy or interval, selection continues from
  /// the kernel in use; with other candidates it starts over, keeping only costs and disabled kernels. A single
  /// candidate is used even if it was disabled.
  /// @throws InputError that starts with `place` if `json` was not written by to_json()
  nlohmann::ordered_json to_json() const;
  void restore(const nlohmann::ordered_json& json, const std::string& place);

  static constexpr int kMinViews = 3;  // the spread cannot be estimated from fewer

 private:
  /// How much faster a kernel is than the one in use, in natural logarithms of time ratios, which are symmetric.
  struct Lead {
    std::string kernel;
    double median = 0;   // > 0 = it is faster
    double margin = -1;  // -1: fewer than kMinViews views have valid times of both
    bool is_known() const { return margin >= 0; }
    bool is_certain() const { return is_known() && median > margin; }
  };
  /// Of all candidates but the one in use.
  std::vector<Lead> leads(const std::vector<KernelMeasurement>& measurements) const;
  void choose(const std::vector<Lead>& leads, KernelDecision& decision);
  std::string first_enabled() const;

  KernelSelectorOptions options_;
  std::string kernel_;
  std::map<std::string, std::string> disabled_;  // kernel: why
  int last_check_ = 0;                           // iteration; 0 = none yet
  std::vector<double> costs_ms_;                 // of all checks
};

/// Fields of the log's "kernel_times" and "kernel_check" lines.
nlohmann::ordered_json to_json(const KernelTimes& times);
nlohmann::ordered_json to_json(const KernelDecision& decision);

}  // namespace b3dgs
