#include "report/train_log_reader.h"

#include <algorithm>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>
#include <set>
#include <type_traits>
#include <utility>

#include "adaptive/load_statistics.h"
#include "core/json_text.h"

namespace b3dgs {
namespace {

using Json = nlohmann::ordered_json;

std::optional<double> number(const Json& json, const char* key) {
  const auto it = json.find(key);
  return it != json.end() && it->is_number() ? std::optional(it->get<double>()) : std::nullopt;
}

/// nullopt if the value is missing, not an integer, or out of range for the type.
template <class Integer>
std::optional<Integer> whole_number(const Json& json, const char* key) {
  const auto it = json.find(key);
  if (it == json.end()) return std::nullopt;
  try {
    return json_integer<Integer>(*it, key, "");
  } catch (const InputError&) {
    return std::nullopt;
  }
}

std::string text(const Json& json, const char* key) {
  const auto it = json.find(key);
  return it != json.end() && it->is_string() ? it->get<std::string>() : "";
}

std::vector<std::string> texts(const Json& json, const char* key) {
  std::vector<std::string> found;
  const auto it = json.find(key);
  if (it == json.end() || !it->is_array()) return found;
  for (const Json& value : *it) {
    if (value.is_string()) found.push_back(value.get<std::string>());
  }
  return found;
}

NamedTimes named_times(const Json& json, const char* key) {
  NamedTimes times;
  const auto it = json.find(key);
  if (it == json.end() || !it->is_object()) return times;
  for (const auto& [name, value] : it->items()) {
    if (value.is_number()) times.emplace_back(name, value.get<double>());
  }
  return times;
}

/// Without elapsed_s in the line, it is computed from the point `before` and this line's mean time per step.
LogPoint parse_point(const Json& json, int iteration, const LogPoint& before) {
  LogPoint point;
  point.iteration = iteration;
  point.loss = number(json, "loss");
  point.ms = number(json, "ms");
  point.test_psnr = number(json, "test_psnr");
  point.test_ssim = number(json, "test_ssim");
  point.count = whole_number<std::int64_t>(json, "count");
  point.gpu_peak_bytes = whole_number<std::int64_t>(json, "gpu_peak_bytes");
  point.kernel = text(json, "kernel");
  point.backward_kernel = text(json, "backward_kernel");
  point.stages_ms = named_times(json, "stages_ms");
  const double summed_s = before.elapsed_s + 1e-3 * point.ms.value_or(0) * (iteration - before.iteration);
  point.elapsed_s = number(json, "elapsed_s").value_or(summed_s);
  return point;
}

KernelCheckEvent parse_check(const Json& json, int iteration) {
  KernelCheckEvent check;
  check.iteration = iteration;
  check.pass = text(json, "pass");
  check.times_ms = named_times(json, "times_ms");
  check.spread_ms = named_times(json, "spread_ms");
  check.views = whole_number<int>(json, "views");
  check.before = text(json, "before");
  check.after = text(json, "after");
  check.reason = text(json, "reason");
  check.disabled = texts(json, "refused");
  check.cost_ms = number(json, "cost_ms");
  check.warm_up_ms = number(json, "warm_up_ms");
  return check;
}

using TimedPasses = std::set<std::pair<int, std::string>>;  // (iteration, pass)

/// Keeps the first of two timings at one iteration: a check runs before the step, a measurement for the log after it.
void add_candidate_times(CandidateTimes times, TimedPasses& known, TrainHistory& history) {
  if (known.emplace(times.iteration, times.pass).second) history.candidate_times.push_back(std::move(times));
}

std::optional<LoadFigures> parse_load(const Json& json, const char* key) {
  const auto it = json.find(key);
  if (it == json.end() || !it->is_object()) return std::nullopt;
  LoadFigures load;
  visit_load_figures(load, [&](const char* name, auto& value) {
    if constexpr (std::is_same_v<std::decay_t<decltype(value)>, double>) {
      value = number(*it, name).value_or(0);
    } else if (const auto bins = it->find(name); bins != it->end() && bins->is_array()) {
      for (const Json& count : *bins) value.push_back(count.is_number() ? count.get<double>() : 0);
    }
  });
  return load;
}

}  // namespace

std::vector<KernelPeriod> kernel_periods(const TrainHistory& history) {
  std::map<int, std::string> kernel_of;  // by iteration, where known
  for (const LogPoint& point : history.points) {
    if (!point.kernel.empty()) kernel_of[point.iteration] = point.kernel;
  }
  for (const KernelCheckEvent& check : history.checks) {  // a check runs before the step of its iteration
    if (check.pass != "forward" || check.before.empty() || check.after.empty()) continue;
    if (check.iteration > 1) kernel_of[check.iteration - 1] = check.before;
    kernel_of[check.iteration] = check.after;
  }
  std::vector<KernelPeriod> periods;
  for (const auto& [iteration, kernel] : kernel_of) {
    if (periods.empty() || periods.back().kernel != kernel) {
      periods.push_back({kernel, periods.empty() ? 0 : periods.back().until, iteration});
    }
    periods.back().until = iteration;
  }
  if (!periods.empty()) periods.back().until = std::max(periods.back().until, history.last_iteration());
  return periods;
}

TrainHistory parse_train_log(std::istream& lines) {
  TrainHistory history;
  TimedPasses timed;
  for (std::string line; std::getline(lines, line);) {
    const Json json = parse_json(line);
    if (!json.is_object()) continue;
    const std::optional<int> found = whole_number<int>(json, "iteration");
    if (!found || *found < 0) continue;
    const int iteration = *found;
    const std::string event = text(json, "event");
    if (event == "kernel_check") {
      const KernelCheckEvent& check = history.checks.emplace_back(parse_check(json, iteration));
      add_candidate_times({iteration, check.pass, check.times_ms}, timed, history);
    } else if (event == "kernel_times") {
      add_candidate_times({iteration, text(json, "pass"), named_times(json, "times_ms")}, timed, history);
    } else if (event == "held") {
      history.holds.push_back({iteration, whole_number<std::int64_t>(json, "count").value_or(0), text(json, "reason")});
    } else if (event == "load_statistics") {
      history.loads.push_back({iteration, parse_load(json, "tile_lists"), parse_load(json, "pixel_processed"),
                               parse_load(json, "pixel_contributing")});
    } else if (event == "floaters") {
      const auto count = [&](const char* name) { return whole_number<std::int64_t>(json, name).value_or(0); };
      history.floaters.push_back({iteration, count("unseen"), count("one_view"), count("close"), count("large")});
    } else if (event == "resumed") {
      history.resumes.push_back(
          {iteration, text(json, "kernel"), text(json, "backward_kernel"), texts(json, "changed_options")});
    } else if (!json.contains("event") && iteration > history.last_iteration()) {
      const LogPoint before = history.points.empty() ? LogPoint{} : history.points.back();
      history.points.push_back(parse_point(json, iteration, before));
    }
  }
  return history;
}

TrainHistory read_train_log(const std::filesystem::path& path) {
  std::ifstream file(path);
  return parse_train_log(file);
}

}  // namespace b3dgs
