#include "adaptive/kernel_selector.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <iterator>
#include <limits>
#include <set>
#include <utility>

#include "core/check.h"
#include "core/json_text.h"

namespace b3dgs {
namespace {

using Json = nlohmann::ordered_json;

/// Clock frequencies and caches make times of the same kernel differ by about this much.
constexpr double kMinMargin = 0.01;
/// The margin in standard errors. With a handful of views the error estimate itself is uncertain: with three, noise of
/// 3 % selects a kernel that is 5 % slower in less than one of 100 checks.
constexpr double kStandardErrors = 3;
/// Tracking switches at once if the lead exceeds the margin by this, else after two checks in a row.
constexpr double kClearLead = 0.1;
/// Tracking: the interval between checks grows to at most this multiple while nothing changes. Density control rebuilds
/// a scene within a few thousand iterations; rarer checks would miss that.
constexpr int kMaxBackOff = 4;

double median(std::vector<double> values) {
  if (values.empty()) return 0;
  std::sort(values.begin(), values.end());
  const std::size_t middle = values.size() / 2;
  return values.size() % 2 == 1 ? values[middle] : 0.5 * (values[middle - 1] + values[middle]);
}

/// Standard deviation estimated by the median absolute deviation, for normal noise: robust to single interrupted runs.
double robust_deviation(const std::vector<double>& values) {
  const double center = median(values);
  std::vector<double> distances;
  distances.reserve(values.size());
  for (const double value : values) distances.push_back(std::fabs(value - center));
  return 1.4826 * median(distances);
}

/// Standard error of the median; for normal noise it is 1.2533 times that of the mean.
double standard_error_of_median(const std::vector<double>& values) {
  return 1.2533 * robust_deviation(values) / std::sqrt(static_cast<double>(values.size()));
}

bool is_time(double ms) {
  return std::isfinite(ms) && ms > 0;
}

std::vector<double> valid_times(const KernelMeasurement& measurement) {
  std::vector<double> valid;
  std::copy_if(measurement.ms.begin(), measurement.ms.end(), std::back_inserter(valid), is_time);
  return valid;
}

const KernelMeasurement* find_measurement(const std::vector<KernelMeasurement>& measurements,
                                          const std::string& kernel) {
  for (const KernelMeasurement& measurement : measurements) {
    if (measurement.kernel == kernel) return &measurement;
  }
  return nullptr;
}

/// "12.3 %"
std::string percent(double share) {
  char text[32];
  std::snprintf(text, sizeof text, "%.1f %%", 100 * share);
  return text;
}

const char* policy_name(KernelPolicy policy) {
  switch (policy) {
    case KernelPolicy::kPaper:
      return "paper";
    case KernelPolicy::kTracking:
      return "tracking";
    case KernelPolicy::kPublished:
      return "published";
  }
  return "";
}

KernelDecision decision_from_json(const Json& json, const std::string& place) {
  KernelDecision decision;
  decision.iteration = json_integer<int>(json.at("iteration"), "iteration", place, 0);
  json.at("times_ms").get_to(decision.times_ms);
  json.at("spread_ms").get_to(decision.spread_ms);
  decision.views = json_integer<int>(json.at("views"), "views", place, 0);
  json.at("before").get_to(decision.before);
  json.at("after").get_to(decision.after);
  json.at("reason").get_to(decision.reason);
  if (json.contains("refused")) json.at("refused").get_to(decision.disabled);
  json.at("cost_ms").get_to(decision.cost_ms);
  if (decision.cost_ms < 0) input_error(place, ": cost_ms must be at least 0, found ", decision.cost_ms);
  // Missing in checkpoints of early versions.
  decision.step_ms = json.value("step_ms", 0.0);
  if (json.contains("next_check")) decision.next_check = json_integer<int>(json["next_check"], "next_check", place, 0);
  return decision;
}

}  // namespace

KernelTimes summarize(const std::vector<KernelMeasurement>& measurements) {
  KernelTimes times;
  for (const KernelMeasurement& measurement : measurements) {
    const std::vector<double> ms = valid_times(measurement);
    if (ms.empty()) continue;
    times.times_ms[measurement.kernel] = median(ms);
    times.spread_ms[measurement.kernel] = robust_deviation(ms);
    times.views = std::max(times.views, static_cast<int>(ms.size()));
  }
  return times;
}

/// How much faster one kernel is than another, in natural logarithms of time ratios, which are symmetric.
struct KernelSelector::Lead {
  double median = 0;  // > 0 = the other kernel is faster
  double margin = 0;
  std::size_t n_pairs = 0;
  bool is_certain() const { return median > margin; }
  bool has_enough_pairs() const { return n_pairs >= static_cast<std::size_t>(kMinViews); }
};

KernelSelector::KernelSelector(KernelSelectorOptions options) : options_(std::move(options)) {
  const std::vector<std::string>& names = options_.candidates;
  B3DGS_CHECK(!names.empty() && std::set<std::string>(names.begin(), names.end()).size() == names.size(),
              "expected at least one candidate, and no duplicates, found ", Json(names).dump());
  B3DGS_CHECK(options_.cost_share > 0, "cost_share must be above 0, found ", options_.cost_share);
  B3DGS_CHECK(options_.interval >= 1, "interval must be at least 1, found ", options_.interval);
  kernel_ = names.front();
}

bool KernelSelector::is_candidate(const std::string& kernel) const {
  const std::vector<std::string>& names = options_.candidates;
  return std::find(names.begin(), names.end(), kernel) != names.end() && disabled_.count(kernel) == 0;
}

std::string KernelSelector::first_enabled() const {
  for (const std::string& name : options_.candidates) {
    if (is_candidate(name)) return name;
  }
  return options_.reference;
}

std::vector<std::string> KernelSelector::candidates() const {
  std::vector<std::string> names{kernel_};
  for (const std::string& name : options_.candidates) {
    if (name != kernel_ && is_candidate(name)) names.push_back(name);
  }
  return names;
}

bool KernelSelector::is_finished() const {
  if (candidates().size() < 2) return true;
  return options_.policy != KernelPolicy::kTracking && kernel_ != options_.candidates.front();
}

bool KernelSelector::is_affordable(double cost_ms, int n_steps, double step_ms) const {
  return cost_ms <= options_.cost_share * n_steps * step_ms;
}

double KernelSelector::cost_with_next_ms() const {
  double sum_ms = history_.back().cost_ms;
  for (const KernelDecision& decision : history_) sum_ms += decision.cost_ms;
  return sum_ms;
}

double KernelSelector::budget_ms(double step_ms) const {
  if (step_ms <= 0 || options_.policy == KernelPolicy::kPublished) return std::numeric_limits<double>::infinity();
  return options_.cost_share * options_.interval * step_ms;
}

/// The multiple of the interval at which the next check comes if its cost is ignored.
int KernelSelector::next_multiple() const {
  const int back_off = options_.policy == KernelPolicy::kTracking ? back_off_ : 1;
  const std::int64_t next = (std::int64_t{last_check_} / options_.interval + back_off) * options_.interval;
  return static_cast<int>(std::min<std::int64_t>(next, std::numeric_limits<int>::max()));
}

bool KernelSelector::is_due(const CheckMoment& now) const {
  if (is_finished()) return false;
  if (options_.policy == KernelPolicy::kPublished) return now.iteration >= next_multiple();
  if (now.is_after_reset) return false;
  if (history_.empty()) return true;
  if (!is_affordable(history_.back().cost_ms, now.n_steps_left, now.step_ms)) return false;
  if (last_check_ == 0) return true;
  return now.iteration >= next_multiple() && is_affordable(cost_with_next_ms(), now.iteration - 1, now.step_ms);
}

/// Iteration of the next check if steps keep taking `step_ms`; 0 = none.
int KernelSelector::earliest_check(double step_ms) const {
  if (is_finished()) return 0;
  if (step_ms <= 0 || options_.policy == KernelPolicy::kPublished) return next_multiple();
  const double n_steps = std::ceil(cost_with_next_ms() / (options_.cost_share * step_ms));
  constexpr double kNever = std::numeric_limits<int>::max();
  return std::max(next_multiple(), static_cast<int>(std::min(kNever, 1 + n_steps)));
}

KernelSelector::Lead KernelSelector::lead_over_current(const KernelMeasurement& other,
                                                       const KernelMeasurement& current) const {
  std::vector<double> ratios;
  for (std::size_t view = 0; view < std::min(other.ms.size(), current.ms.size()); ++view) {
    if (!is_time(other.ms[view]) || !is_time(current.ms[view])) continue;
    ratios.push_back(std::log(current.ms[view] / other.ms[view]));
  }
  if (ratios.empty()) return {};
  const double margin = options_.policy == KernelPolicy::kPublished
                            ? 0
                            : std::max(kMinMargin, kStandardErrors * standard_error_of_median(ratios));
  return {median(ratios), margin, ratios.size()};
}

bool KernelSelector::is_clear(const std::vector<KernelMeasurement>& measurements) const {
  const KernelMeasurement* const current = find_measurement(measurements, kernel_);
  return current != nullptr && options_.policy != KernelPolicy::kPublished &&
         std::all_of(measurements.begin(), measurements.end(), [&](const KernelMeasurement& other) {
           if (other.kernel == kernel_ || !other.fault.empty() || !is_candidate(other.kernel)) return true;
           const Lead lead = lead_over_current(other, *current);
           return lead.has_enough_pairs() && std::fabs(lead.median) > 2 * lead.margin;
         });
}

const KernelDecision& KernelSelector::decide(const CheckMoment& now, const std::vector<KernelMeasurement>& measurements,
                                             double cost_ms) {
  KernelDecision decision;
  decision.iteration = now.iteration;
  decision.before = kernel_;
  decision.cost_ms = cost_ms;
  decision.step_ms = now.step_ms;
  static_cast<KernelTimes&>(decision) = summarize(measurements);
  disable_faulty(measurements, decision);
  if (disabled_.count(kernel_) > 0) {
    replace_disabled(measurements, decision);
  } else {
    choose(measurements, decision);
  }
  decision.after = kernel_;
  last_check_ = now.iteration;
  history_.push_back(std::move(decision));
  history_.back().next_check = earliest_check(now.step_ms);
  return history_.back();
}

void KernelSelector::disable_faulty(const std::vector<KernelMeasurement>& measurements, KernelDecision& decision) {
  for (const KernelMeasurement& measurement : measurements) {
    if (measurement.fault.empty()) continue;
    disabled_[measurement.kernel] = measurement.fault;
    decision.disabled.push_back(measurement.kernel);
    decision.reason +=
        detail::concat(decision.reason.empty() ? "" : "; ", measurement.kernel, " is disabled: ", measurement.fault);
    if (challenger_ == measurement.kernel) challenger_.clear();
  }
}

/// Replaces a disabled kernel by the fastest candidate that agrees with the reference, else by the reference itself.
void KernelSelector::replace_disabled(const std::vector<KernelMeasurement>& measurements, KernelDecision& decision) {
  double least_ms = std::numeric_limits<double>::infinity();
  kernel_ = first_enabled();
  for (const KernelMeasurement& measurement : measurements) {
    const auto ms = decision.times_ms.find(measurement.kernel);
    if (!is_candidate(measurement.kernel) || ms == decision.times_ms.end() || ms->second >= least_ms) continue;
    least_ms = ms->second;
    kernel_ = measurement.kernel;
  }
  back_off_ = 1;
}

void KernelSelector::choose(const std::vector<KernelMeasurement>& measurements, KernelDecision& decision) {
  const KernelMeasurement* const current = find_measurement(measurements, kernel_);
  std::string fastest;  // among those that lead by more than their margin, or among all if there are none
  Lead best;
  for (const KernelMeasurement& other : measurements) {
    if (current == nullptr || other.kernel == kernel_ || !is_candidate(other.kernel)) continue;
    const Lead lead = lead_over_current(other, *current);
    if (!lead.has_enough_pairs()) continue;
    // A lead within its margin may be noise, however large: it must not hide a smaller lead that is certain.
    const auto rank = [](const Lead& one) { return std::make_pair(one.is_certain(), one.median); };
    if (!fastest.empty() && rank(lead) <= rank(best)) continue;
    fastest = other.kernel;
    best = lead;
  }
  if (!decision.reason.empty()) decision.reason += "; ";
  if (fastest.empty()) {
    decision.reason += detail::concat("no two candidates have valid times on ", kMinViews, " or more views");
    return;
  }
  decision.reason += decide_challenge(fastest, best);
}

/// Switches to the challenger or not; returns the reason.
std::string KernelSelector::decide_challenge(const std::string& challenger, const Lead& lead) {
  std::string figures = detail::concat(challenger, " takes ", percent(std::fabs(std::expm1(-lead.median))),
                                       lead.median >= 0 ? " less" : " more", " time than ", kernel_, " (margin ",
                                       percent(std::expm1(lead.margin)), ")");
  if (!lead.is_certain()) {
    back_off_ = std::min(2 * back_off_, kMaxBackOff);
    challenger_.clear();
    return figures;
  }
  back_off_ = 1;
  const bool waits = options_.policy == KernelPolicy::kTracking && lead.median <= lead.margin + kClearLead &&
                     challenger_ != challenger;
  if (waits) {
    challenger_ = challenger;
    return figures + "; switches if the next check confirms it";
  }
  kernel_ = challenger;
  challenger_.clear();
  return figures;
}

nlohmann::ordered_json KernelSelector::to_json() const {
  Json history = Json::array();
  for (const KernelDecision& decision : history_) history.push_back(b3dgs::to_json(decision));
  return {{"policy", policy_name(options_.policy)},
          {"candidates", options_.candidates},
          {"interval", options_.interval},
          {"kernel", kernel_},
          {"refused", disabled_},
          {"last_check", last_check_},
          {"challenger", challenger_},
          {"back_off", back_off_},
          {"history", std::move(history)}};
}

void KernelSelector::restore(const nlohmann::ordered_json& json, const std::string& place) {
  try {
    restore_checked(json, place);
  } catch (const nlohmann::json::exception& error) {
    input_error(place, ": invalid history of kernel checks: ", error.what());
  }
}

void KernelSelector::restore_checked(const nlohmann::ordered_json& json, const std::string& place) {
  KernelSelector read(options_);
  for (const Json& decision : json.at("history")) read.history_.push_back(decision_from_json(decision, place));
  if (options_.candidates.size() > 1) json.at("refused").get_to(read.disabled_);
  read.kernel_ = read.first_enabled();
  const auto kernel = json.at("kernel").get<std::string>();
  const bool same_candidates = json.at("candidates").get<std::vector<std::string>>() == options_.candidates;
  if (same_candidates && (read.is_candidate(kernel) || kernel == options_.reference)) {
    read.kernel_ = kernel;
    read.last_check_ = json_integer<int>(json.at("last_check"), "last_check", place, 0);
    json.at("challenger").get_to(read.challenger_);
    read.back_off_ = json_integer<int>(json.at("back_off"), "back_off", place, 1, kMaxBackOff);
  }
  *this = std::move(read);
}

std::string describe_change(const KernelDecision& decision, bool is_final) {
  std::string text;
  for (const auto& [kernel, ms] : decision.times_ms) {
    char time[48];
    std::snprintf(time, sizeof time, " %.3g ms", ms);
    text += (text.empty() ? "" : ", ") + kernel + time;
  }
  if (!decision.disabled.empty()) {
    text = decision.reason + (text.empty() ? "" : " (" + text + ")");
  } else if (decision.before == decision.after) {
    return "";
  }
  return detail::concat("iteration ", decision.iteration, ": ", text, ": using ", decision.after,
                        is_final ? ", permanently" : ", until the next check");
}

nlohmann::ordered_json to_json(const KernelTimes& times) {
  return {{"times_ms", times.times_ms}, {"spread_ms", times.spread_ms}, {"views", times.views}};
}

nlohmann::ordered_json to_json(const KernelDecision& decision) {
  Json json = {{"iteration", decision.iteration}};
  json.update(to_json(static_cast<const KernelTimes&>(decision)));
  json["before"] = decision.before;
  json["after"] = decision.after;
  json["reason"] = decision.reason;
  json["cost_ms"] = decision.cost_ms;
  if (decision.step_ms > 0) json["step_ms"] = decision.step_ms;
  if (decision.next_check > 0) json["next_check"] = decision.next_check;
  if (!decision.disabled.empty()) json["refused"] = decision.disabled;
  return json;
}

}  // namespace b3dgs
