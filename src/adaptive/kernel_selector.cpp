#include "adaptive/kernel_selector.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "core/check.h"
#include "core/text.h"

namespace b3dgs {
namespace {

using Json = nlohmann::ordered_json;

/// Times of the same kernel differ by about this fraction, because of clock frequencies and caches.
constexpr double kMinLead = 0.01;
constexpr double kStandardErrors = 3;

bool is_valid(double ms) {
  return std::isfinite(ms) && ms > 0;
}

}  // namespace

KernelSelector::KernelSelector(KernelRule rule) : rule_(std::move(rule)) {
  B3DGS_CHECK(!rule_.first.empty() && rule_.first != rule_.second, "two kernels expected, found \"", rule_.first,
              "\" and \"", rule_.second, "\"");
  B3DGS_CHECK(rule_.interval >= 1, "interval must be at least 1, found ", rule_.interval);
}

int KernelSelector::check_of(int iteration) const {
  if (rule_.second.empty() || iteration < 1) return -1;
  const int n_views = is_final() ? kLoggedViews : kViews;
  return (iteration - 1) % rule_.interval < n_views ? (iteration - 1) / rule_.interval : -1;
}

KernelDecision KernelSelector::decide(int next_iteration, std::vector<ViewTimes> views) {
  views.erase(
      std::remove_if(views.begin(), views.end(),
                     [](const ViewTimes& view) { return !is_valid(view.in_use_ms) || !is_valid(view.other_ms); }),
      views.end());
  const auto n = static_cast<double>(views.size());
  double in_use_ms = 0, other_ms = 0;
  for (const ViewTimes& view : views) in_use_ms += view.in_use_ms, other_ms += view.other_ms;
  const double lead_ms = in_use_ms - other_ms;
  double squares = 0;  // squared deviations of the differences from their mean
  for (const ViewTimes& view : views) squares += std::pow(view.in_use_ms - view.other_ms - lead_ms / n, 2);
  const double error_ms = views.size() > 1 ? std::sqrt(squares / (n - 1) * n) : 0;  // standard error of the sum

  KernelDecision decision;
  decision.iteration = next_iteration;
  decision.views = static_cast<int>(views.size());
  decision.before = decision.after = kernel();
  if (views.empty()) {
    decision.reason = "no view has valid times of both kernels";
    return decision;
  }
  decision.times_ms = {{kernel(), in_use_ms / n}, {other(), other_ms / n}};
  decision.error_ms = error_ms / n;
  decision.reason =
      other() + print_to_string(" takes %.1f %% %s, standard error %.1f %%", 100 * std::fabs(lead_ms) / in_use_ms,
                                lead_ms > 0 ? "less" : "more", 100 * error_ms / in_use_ms);
  bool switches = false;
  switch (rule_.policy) {
    case KernelPolicy::kAdaptive:
      switches = decision.views >= kMinViews && lead_ms > std::max(kMinLead * in_use_ms, kStandardErrors * error_ms);
      break;
    case KernelPolicy::kPublished:
      switches = !is_final() && next_iteration > rule_.interval && lead_ms > 0;
      break;
    case KernelPolicy::kFixed:
      break;
  }
  if (!switches) return decision;
  is_second_ = !is_second_;
  decision.after = kernel();
  decision.message =
      detail::concat("iteration ", next_iteration, ": ", decision.before, print_to_string(" %.3g ms, ", in_use_ms / n),
                     decision.after, print_to_string(" %.3g ms: using ", other_ms / n), decision.after,
                     rule_.policy == KernelPolicy::kPublished ? " for the rest" : "");
  return decision;
}

Json KernelSelector::to_json(const std::string& device) const {
  return {{"device", device}, {"kernels", {rule_.first, rule_.second}}, {"kernel", kernel()}};
}

void KernelSelector::restore(const Json& json, const std::string& device, const std::string& place) try {
  is_second_ = false;
  if (!json.contains("kernels")) return;
  const auto kernels = json.at("kernels").get<std::array<std::string, 2>>();
  const bool was_second = json.at("kernel").get<std::string>() == kernels[1];
  const bool is_same =
      kernels[0] == rule_.first && kernels[1] == rule_.second && json.at("device").get<std::string>() == device;
  is_second_ = is_same && was_second && rule_.policy != KernelPolicy::kFixed;
} catch (const nlohmann::json::exception& error) {
  input_error(place, ": invalid state of the kernel selection: ", error.what());
}

Json to_json(const KernelDecision& decision) {
  return {{"views", decision.views},     {"times_ms", decision.times_ms}, {"error_ms", decision.error_ms},
          {"cost_ms", decision.cost_ms}, {"before", decision.before},     {"after", decision.after},
          {"reason", decision.reason}};
}

}  // namespace b3dgs
