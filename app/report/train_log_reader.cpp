#include "app/report/train_log_reader.h"

#include <algorithm>
#include <map>
#include <sstream>
#include <type_traits>

#include "core/files/file_reader.h"
#include "core/json_text.h"

namespace b3dgs {
namespace {

using Json = nlohmann::ordered_json;

/// The members of the events that reports show, with values of their types. Missing members and those of another type
/// get this value. null: a number or nothing; {}: numbers by name; a list: of such values.
const Json& event_members() {
  static const Json load{{"min", 0}, {"median", 0}, {"p90", 0},    {"p99", 0},
                         {"max", 0}, {"mean", 0.0}, {"gini", 0.0}, {"log2_bins", Json::array({0})}};
  static const Json members{
      {"kernel_check",
       {{"iteration", 0},
        {"views", nullptr},
        {"times_ms", Json::object()},  // by kernel: mean over the views
        {"error_ms", nullptr},         // standard error of the mean difference
        {"cost_ms", nullptr},
        {"before", ""},  // kernel in use
        {"after", ""},   // from this iteration on
        {"reason", ""}}},
      // Distributions over the tiles and pixels of all views together.
      {"load_statistics",
       {{"iteration", 0},
        {"views", nullptr},
        {"tile_lists", load},
        {"pixel_processed", load},
        {"pixel_contributing", load}}},
      // The number of Gaussians has reached a limit, and never exceeds `count` after this.
      {"capped", {{"iteration", 0}, {"count", 0}, {"reason", ""}}},
      {"floaters", {{"iteration", 0}, {"unseen", 0}, {"one_view", 0}, {"close", 0}, {"large", 0}}},
      // After `iteration`, with this kernel. Options have the form "name: old -> new".
      {"resumed", {{"iteration", 0}, {"kernel", ""}, {"changed_options", Json::array({""})}}}};
  return members;
}

bool has_type_of(const Json& example, const Json& json) {
  if (example.is_number_integer()) return json.is_number_integer();
  return example.is_number() || example.is_null() ? json.is_number() : json.type() == example.type();
}

/// Returns `json` with the members of `expected`, each of its type. An entry that is not an object becomes null.
Json checked(const Json& json, const Json& expected) {
  if (!expected.is_structured()) return has_type_of(expected, json) ? json : expected;
  if (expected.is_object() && !expected.empty()) {
    if (!json.is_object()) return nullptr;
    Json record;
    for (const auto& [name, member] : expected.items()) record[name] = checked(json.value(name, Json()), member);
    return record;
  }
  Json all = expected.is_array() ? Json::array() : Json::object();
  if (json.type() != expected.type()) return all;
  for (const auto& [name, own] : json.items()) {
    if (expected.is_array() && has_type_of(expected[0], own)) all.push_back(own);
    if (expected.is_object() && own.is_number()) all[name] = own;
  }
  return all;
}

// Reads a member of a line. Returns false, and leaves `to` unchanged, if it has another type or is out of range.

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

template <class Value>
bool read(const Json& json, std::optional<Value>& to) {
  if (Value value{}; read(json, value)) to = value;
  return to.has_value();
}

LogPoint parse_point(const Json& json) {
  LogPoint point;
  const auto field = [&](const char* key, auto& value) { read(json.value(key, Json()), value); };
  LogPoint::visit_curves(point, field);
  field("gpu_peak_bytes", point.gpu_peak_bytes);
  point.stages_ms = checked(json.value("stages_ms", Json()), Json::object());
  return point;
}

}  // namespace

Json TrainHistory::no_events() {
  Json none;
  for (const auto& [event, members] : event_members().items()) none[event] = Json::array();
  return none;
}

bool switches_kernel(const Json& check) {
  return check["after"] != "" && check["before"] != check["after"];
}

std::vector<KernelPeriod> kernel_periods(const TrainHistory& history) {
  std::map<int, std::string> kernel_of;  // by iteration, where known
  for (const LogPoint& point : history.points) {
    if (!point.kernel.empty()) kernel_of[point.iteration] = point.kernel;
  }
  for (const Json& check : history.events["kernel_check"]) {  // before the step of its iteration
    if (check["before"] == "" || check["after"] == "") continue;
    const int iteration = check["iteration"];
    if (iteration > 1) kernel_of[iteration - 1] = check["before"];
    kernel_of[iteration] = check["after"];
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
    if (json.is_object()) read(json.value("iteration", Json()), iteration);
    if (iteration < 0) continue;
    if (json.contains("event")) {
      const Json& event = json["event"];
      const auto members = event.is_string() ? event_members().find(event.get<std::string>()) : event_members().end();
      if (members != event_members().end()) history.events[members.key()].push_back(checked(json, *members));
    } else if (iteration > history.last_iteration()) {
      history.points.push_back(parse_point(json));
    }
  }
  return history;
}

TrainHistory read_train_log(const std::filesystem::path& path) {
  std::istringstream file(read_file_if_there(path).value_or(""));
  return parse_train_log(file);
}

}  // namespace b3dgs
