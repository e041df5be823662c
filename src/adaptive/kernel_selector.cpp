#include "adaptive/kernel_selector.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>
#include <numeric>
#include <set>
#include <tuple>
#include <utility>

#include "core/check.h"
#include "core/json_text.h"
#include "core/text.h"

namespace b3dgs {
namespace {

using Json = nlohmann::ordered_json;

/// Clock frequencies and caches make times of the same kernel differ by about this much.
constexpr double kMinMargin = 0.01;
/// The margin in standard errors. With a handful of views the error estimate itself is uncertain: with three, noise of
/// 3 % selects a kernel that is 5 % slower in less than one of 100 checks.
constexpr double kStandardErrors = 3;

double median(std::vector<double> values) {
  if (values.empty()) return 0;
  std::sort(values.begin(), values.end());
  const std::size_t middle = values.size() / 2;
  return values.size() % 2 == 1 ? values[middle] : 0.5 * (values[middle - 1] + values[middle]);
}

/// Standard deviation estimated by the median absolute deviation, for normal noise: robust to single interrupted runs.
double robust_deviation(const std::vector<double>& values) {
  const double center = median(values);
  std::vector<double> distances = values;
  for (double& value : distances) value = std::fabs(value - center);
  return 1.4826 * median(distances);
}

/// Standard error of the median; for normal noise it is 1.2533 times that of the mean.
double standard_error_of_median(const std::vector<double>& values) {
  return 1.2533 * robust_deviation(values) / std::sqrt(static_cast<double>(values.size()));
}

std::vector<double> valid_times(const KernelMeasurement& measurement) {
  std::vector<double> valid;
  std::copy_if(measurement.ms.begin(), measurement.ms.end(), std::back_inserter(valid),
               [](double ms) { return std::isfinite(ms) && ms > 0; });
  return valid;
}

/// "12.3 %"
std::string percent(double share) {
  return print_to_string("%.1f %%", 100 * share);
}

/// One line for the user if a check changes something, else "".
std::string describe_change(const KernelDecision& decision, bool is_final) {
  std::string text;
  for (const auto& [kernel, ms] : decision.times_ms) {
    text += (text.empty() ? "" : ", ") + kernel + print_to_string(" %.3g ms", ms);
  }
  if (!decision.disabled.empty()) {
    text = decision.reason + (text.empty() ? "" : " (" + text + ")");
  } else if (decision.before == decision.after) {
    return "";
  }
  return detail::concat("iteration ", decision.iteration, ": ", text, ": using ", decision.after,
                        is_final ? ", permanently" : ", until the next check");
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

KernelSelector::KernelSelector(KernelSelectorOptions options) : options_(std::move(options)) {
  const std::vector<std::string>& names = options_.candidates;
  B3DGS_CHECK(!names.empty() && std::set<std::string>(names.begin(), names.end()).size() == names.size(),
              "expected at least one candidate, and no duplicates, found ", Json(names).dump());
  B3DGS_CHECK(options_.cost_share > 0, "cost_share must be above 0, found ", options_.cost_share);
  B3DGS_CHECK(options_.interval >= 1, "interval must be at least 1, found ", options_.interval);
  kernel_ = names.front();
}

std::string KernelSelector::first_enabled() const {
  for (const std::string& name : options_.candidates) {
    if (disabled_.count(name) == 0) return name;
  }
  return options_.reference;
}

std::vector<std::string> KernelSelector::candidates() const {
  std::vector<std::string> names{kernel_};
  for (const std::string& name : options_.candidates) {
    if (name != kernel_ && disabled_.count(name) == 0) names.push_back(name);
  }
  return names;
}

bool KernelSelector::is_finished() const {
  if (candidates().size() < 2) return true;
  return options_.policy != KernelPolicy::kTracking && kernel_ != options_.candidates.front();
}

double KernelSelector::budget_ms(double step_ms) const {
  if (step_ms <= 0 || options_.policy == KernelPolicy::kPublished) return std::numeric_limits<double>::infinity();
  return options_.cost_share * options_.interval * step_ms;
}

bool KernelSelector::is_due(const CheckMoment& now) const {
  if (is_finished()) return false;
  const std::int64_t next_multiple = (std::int64_t{last_check_} / options_.interval + 1) * options_.interval;
  const bool is_over = now.iteration >= next_multiple;
  if (options_.policy == KernelPolicy::kPublished) return is_over;
  if (now.is_after_reset) return false;
  if (last_check_ == 0 || costs_ms_.empty()) return true;
  const double with_this_ms = std::accumulate(costs_ms_.begin(), costs_ms_.end(), costs_ms_.back());
  return is_over && with_this_ms <= options_.cost_share * (now.iteration - 1) * now.step_ms;
}

std::vector<KernelSelector::Lead> KernelSelector::leads(const std::vector<KernelMeasurement>& measurements) const {
  const auto current = std::find_if(measurements.begin(), measurements.end(),
                                    [&](const KernelMeasurement& one) { return one.kernel == kernel_; });
  std::vector<Lead> leads;
  for (const KernelMeasurement& other : measurements) {
    if (other.kernel == kernel_ || !other.fault.empty() || disabled_.count(other.kernel) > 0) continue;
    std::vector<double> ratios;
    for (std::size_t view = 0; current != measurements.end() && view < other.ms.size(); ++view) {
      const double ratio = view < current->ms.size() ? std::log(current->ms[view] / other.ms[view]) : NAN;
      if (std::isfinite(ratio)) ratios.push_back(ratio);
    }
    Lead& lead = leads.emplace_back(Lead{other.kernel});
    if (ratios.size() < static_cast<std::size_t>(kMinViews)) continue;
    lead.median = median(ratios);
    const bool has_margin = options_.policy != KernelPolicy::kPublished;
    lead.margin = has_margin ? std::max(kMinMargin, kStandardErrors * standard_error_of_median(ratios)) : 0;
  }
  return leads;
}

bool KernelSelector::is_clear(const std::vector<KernelMeasurement>& measurements) const {
  const std::vector<Lead> others = leads(measurements);
  return options_.policy != KernelPolicy::kPublished && std::all_of(others.begin(), others.end(), [](const Lead& lead) {
           return lead.is_known() && std::fabs(lead.median) > 2 * lead.margin;
         });
}

KernelDecision KernelSelector::decide(const CheckMoment& now, const std::vector<KernelMeasurement>& measurements,
                                      double cost_ms) {
  KernelDecision decision;
  decision.iteration = now.iteration;
  decision.before = kernel_;
  decision.cost_ms = cost_ms;
  decision.step_ms = now.step_ms;
  static_cast<KernelTimes&>(decision) = summarize(measurements);
  for (const KernelMeasurement& measurement : measurements) {
    if (measurement.fault.empty()) continue;
    disabled_[measurement.kernel] = measurement.fault;
    decision.disabled.push_back(measurement.kernel);
    decision.reason +=
        detail::concat(decision.reason.empty() ? "" : "; ", measurement.kernel, " is disabled: ", measurement.fault);
  }
  if (disabled_.count(kernel_) > 0) kernel_ = first_enabled();
  if (candidates().size() > 1) choose(leads(measurements), decision);
  decision.after = kernel_;
  last_check_ = now.iteration;
  costs_ms_.push_back(cost_ms);
  decision.message = describe_change(decision, is_finished());
  return decision;
}

/// Switches to the fastest candidate if its lead over the kernel in use exceeds the margin.
void KernelSelector::choose(const std::vector<Lead>& leads, KernelDecision& decision) {
  // A lead within its margin may be noise, however large: it must not hide a smaller lead that is certain.
  const auto order = [](const Lead& lead) { return std::tuple(lead.is_known(), lead.is_certain(), lead.median); };
  const auto best =
      std::max_element(leads.begin(), leads.end(), [&](const Lead& a, const Lead& b) { return order(a) < order(b); });
  if (!decision.reason.empty()) decision.reason += "; ";
  if (best == leads.end() || !best->is_known()) {
    decision.reason += detail::concat("no two candidates have valid times on ", kMinViews, " or more views");
    return;
  }
  decision.reason += detail::concat(best->kernel, " takes ", percent(std::fabs(std::expm1(-best->median))),
                                    best->median >= 0 ? " less" : " more", " time than ", kernel_, " (margin ",
                                    percent(std::expm1(best->margin)), ")");
  if (best->is_certain()) kernel_ = best->kernel;
}

nlohmann::ordered_json KernelSelector::to_json() const {
  Json history = Json::array();
  for (const double cost_ms : costs_ms_) history.push_back({{"cost_ms", cost_ms}});
  return {{"candidates", options_.candidates},
          {"kernel", kernel_},
          {"refused", disabled_},
          {"last_check", last_check_},
          {"history", std::move(history)}};
}

void KernelSelector::restore(const nlohmann::ordered_json& json, const std::string& place) try {
  KernelSelector read(options_);
  for (const Json& check : json.at("history")) {  // older files also have what was measured
    read.costs_ms_.push_back(check.at("cost_ms").get<double>());
    if (read.costs_ms_.back() < 0) input_error(place, ": cost_ms must be at least 0, found ", read.costs_ms_.back());
  }
  if (options_.candidates.size() > 1) json.at("refused").get_to(read.disabled_);
  read.kernel_ = read.first_enabled();
  const auto kernel = json.at("kernel").get<std::string>();
  const bool same_candidates = json.at("candidates").get<std::vector<std::string>>() == options_.candidates;
  const std::vector<std::string>& names = options_.candidates;
  const bool is_enabled =
      std::find(names.begin(), names.end(), kernel) != names.end() && read.disabled_.count(kernel) == 0;
  if (same_candidates && (is_enabled || kernel == options_.reference)) {
    read.kernel_ = kernel;
    read.last_check_ = json_integer<int>(json.at("last_check"), "last_check", place, 0);
  }
  *this = std::move(read);
} catch (const nlohmann::json::exception& error) {
  input_error(place, ": invalid history of kernel checks: ", error.what());
}

nlohmann::ordered_json to_json(const KernelTimes& times) {
  return {{"pass", times.pass}, {"times_ms", times.times_ms}, {"spread_ms", times.spread_ms}, {"views", times.views}};
}

nlohmann::ordered_json to_json(const KernelDecision& decision) {
  Json json = to_json(static_cast<const KernelTimes&>(decision));
  json["before"] = decision.before;
  json["after"] = decision.after;
  json["reason"] = decision.reason;
  json["cost_ms"] = decision.cost_ms;
  if (decision.step_ms > 0) json["step_ms"] = decision.step_ms;
  if (!decision.disabled.empty()) json["refused"] = decision.disabled;
  if (decision.warm_up_ms > 0) json["warm_up_ms"] = decision.warm_up_ms;
  return json;
}

}  // namespace b3dgs
