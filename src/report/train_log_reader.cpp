#include "report/train_log_reader.h"

#include <algorithm>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>
#include <type_traits>
#include <utility>

#include "core/json_text.h"

namespace b3dgs {
namespace {

using Json = nlohmann::ordered_json;

// Reads a value of a line. False, and `to` stays as it is, if it has another type or is out of range.

bool read(const Json& json, double& to) {
  if (json.is_number()) to = json.get<double>();
  return json.is_number();
}

bool read(const Json& json, std::string& to) {
  if (json.is_string()) to = json.get<std::string>();
  return json.is_string();
}

template <class Integer, class = std::enable_if_t<std::is_integral_v<Integer>>>
bool read(const Json& json, Integer& to) {
  try {
    to = json_integer<Integer>(json, "", "");
    return true;
  } catch (const InputError&) {
    return false;
  }
}

bool read(const Json& json, NamedTimes& to) {
  if (!json.is_object()) return false;
  for (const auto& [name, value] : json.items()) {
    if (double ms = 0; read(value, ms)) to.emplace_back(name, ms);
  }
  return true;
}

/// Entries of another type are left out.
template <class Entry>
bool read(const Json& json, std::vector<Entry>& to) {
  if (!json.is_array()) return false;
  for (const Json& own : json) {
    if (Entry entry{}; read(own, entry)) to.push_back(entry);
  }
  return true;
}

bool read(const Json& json, LoadStatistics& to);

template <class Value>
bool read(const Json& json, std::optional<Value>& to) {
  if (Value value{}; read(json, value)) to = std::move(value);
  return to.has_value();
}

template <class Value>
void read_member(const Json& json, const char* key, Value& to) {
  if (const auto found = json.find(key); found != json.end()) read(*found, to);
}

bool read(const Json& json, LoadStatistics& to) {
  if (json.is_object()) visit_load_figures(to, [&](const char* name, auto& value) { read_member(json, name, value); });
  return json.is_object();
}

/// What the key has, or an empty value.
template <class Value>
Value get(const Json& json, const char* key) {
  Value value{};
  read_member(json, key, value);
  return value;
}

LogPoint parse_point(const Json& json) {
  LogPoint point;
  const auto field = [&](const char* key, auto& value) { read_member(json, key, value); };
  LogPoint::visit_curves(point, field);
  field("gpu_peak_bytes", point.gpu_peak_bytes);
  field("stages_ms", point.stages_ms);
  return point;
}

KernelCheckEvent parse_check(const Json& json) {
  KernelCheckEvent check;
  KernelCheckEvent::visit(check, [&](const char* key, auto& value) { read_member(json, key, value); });
  return check;
}

/// Keeps the first of two timings at one iteration: a check runs before the step, a measurement for the log after it.
void add_candidate_times(CandidateTimes times, TrainHistory& history) {
  const auto is_same = [&](const CandidateTimes& own) {
    return own.iteration == times.iteration && own.pass == times.pass;
  };
  std::vector<CandidateTimes>& all = history.candidate_times;
  if (std::none_of(all.begin(), all.end(), is_same)) all.push_back(std::move(times));
}

void add_event(const std::string& event, int iteration, const Json& json, TrainHistory& history) {
  const auto count = [&](const char* key) { return get<std::int64_t>(json, key); };
  const auto text = [&](const char* key) { return get<std::string>(json, key); };
  if (event == "kernel_check") {
    history.checks.push_back(parse_check(json));
    add_candidate_times({iteration, history.checks.back().pass, history.checks.back().times_ms}, history);
  } else if (event == "kernel_times") {
    add_candidate_times({iteration, text("pass"), get<NamedTimes>(json, "times_ms")}, history);
  } else if (event == "held") {
    history.holds.push_back({iteration, count("count"), text("reason")});
  } else if (event == "load_statistics") {
    const auto load = [&](const char* key) { return get<std::optional<LoadStatistics>>(json, key); };
    history.loads.push_back({iteration, load("tile_lists"), load("pixel_processed"), load("pixel_contributing")});
  } else if (event == "floaters") {
    history.floaters.push_back({iteration, count("unseen"), count("one_view"), count("close"), count("large")});
  } else if (event == "resumed") {
    history.resumes.push_back(
        {iteration, text("kernel"), text("backward_kernel"), get<std::vector<std::string>>(json, "changed_options")});
  }
}

}  // namespace

std::vector<KernelPeriod> kernel_periods(const TrainHistory& history) {
  std::map<int, std::string> kernel_of;  // by iteration, where known
  for (const LogPoint& point : history.points) {
    if (!point.kernel.empty()) kernel_of[point.iteration] = point.kernel;
  }
  for (const KernelCheckEvent& check : history.checks) {  // a check runs before the step of its iteration
    if (check.pass != kForwardPass || check.before.empty() || check.after.empty()) continue;
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
  for (std::string line; std::getline(lines, line);) {
    const Json json = parse_json(line);
    int iteration = -1;
    if (json.is_object()) read_member(json, "iteration", iteration);
    if (iteration < 0) continue;
    if (json.contains("event")) {
      add_event(get<std::string>(json, "event"), iteration, json, history);
    } else if (iteration > history.last_iteration()) {
      history.points.push_back(parse_point(json));
    }
  }
  return history;
}

TrainHistory read_train_log(const std::filesystem::path& path) {
  std::ifstream file(path);
  return parse_train_log(file);
}

}  // namespace b3dgs
