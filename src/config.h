// Options as structs. A config is a struct with defaults and units in place and one field list:
//
//   template <class Config, class Visitor> void visit_fields(Config& c, Visitor&& field) {
//     field(Option{"iterations"}, c.iterations, AtLeast{1}, "optimisation steps");
//   }
//
// Command-line flags, help, JSON in both directions, range checks and the comparison at resume are visitors over that
// list, so an option, its default and its range exist once. Member types: bool, int, std::int64_t, double, std::string,
// std::vector<int>, std::vector<std::int64_t>, std::vector<double>, std::vector<std::string>.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <initializer_list>
#include <limits>
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>
#include <type_traits>
#include <vector>

#include "check.h"

namespace b3dgs {

/// Name of a field: in JSON, and with two hyphens on the command line, where '-' and '_' are the same.
struct Option {
  std::string_view name;                          // "source_path"
  char letter = '\0';                             // 's' for -s, or none
  std::initializer_list<const char*> other = {};  // names of other trainers for the same thing
};

struct Any {};
struct AtLeast {
  double min;
};
struct Above {
  double min;
};
struct InRange {
  double min, max;  // both included
};
struct OneOf {
  std::vector<std::string> values;
};
/// For a list of names: at least `least` of them, none twice.
struct SomeOf {
  std::vector<std::string> values;
  std::size_t least = 1;
};

/// What a value would have to be, or "" if it is that.
inline std::string violation(const Any&, ...) {
  return "";
}
inline std::string violation(const AtLeast& limit, double value) {
  return value >= limit.min ? "" : detail::concat("at least ", limit.min);
}
inline std::string violation(const Above& limit, double value) {
  return value > limit.min ? "" : detail::concat("above ", limit.min);
}
inline std::string violation(const InRange& limit, double value) {
  return value >= limit.min && value <= limit.max ? "" : detail::concat("from ", limit.min, " to ", limit.max);
}
inline std::string violation(const OneOf& choice, const std::string& value) {
  std::string names;
  for (const std::string& name : choice.values) {
    if (name == value) return "";
    names += (names.empty() ? "" : ", ") + name;
  }
  return "one of " + names;
}
inline std::string violation(const SomeOf& choice, const std::vector<std::string>& values) {
  bool fits = values.size() >= choice.least;
  for (std::size_t i = 0; i < values.size(); ++i) {
    const auto here = values.begin() + static_cast<std::ptrdiff_t>(i);
    fits = fits && std::find(values.begin(), here, values[i]) == here &&
           std::find(choice.values.begin(), choice.values.end(), values[i]) != choice.values.end();
  }
  if (fits) return "";
  std::string names;
  for (const std::string& name : choice.values) names += (names.empty() ? "" : ", ") + name;
  return detail::concat("at least ", choice.least, " different ones of ", names);
}
template <class Constraint, class Number>
std::string violation(const Constraint& constraint, const std::vector<Number>& values) {
  if constexpr (!std::is_same_v<Constraint, Any>) {
    for (Number value : values) {
      if (std::string wanted = violation(constraint, static_cast<double>(value)); !wanted.empty()) return wanted;
    }
  }
  return "";
}

/// Throws an InputError that names the first field out of range; `place` is the file or command it came from.
template <class Config>
void check_ranges(const Config& config, const std::string& place) {
  visit_fields(config, [&](const Option& option, const auto& value, const auto& constraint, const char*) {
    using Constraint = std::decay_t<decltype(constraint)>;
    if constexpr (!std::is_same_v<Constraint, Any>) {
      if (std::string wanted = violation(constraint, value); !wanted.empty()) {
        input_error(place, ": ", option.name, " must be ", wanted, ", found ", nlohmann::json(value).dump());
      }
    }
  });
}

template <class Config>
nlohmann::ordered_json config_to_json(const Config& config) {
  nlohmann::ordered_json json;
  visit_fields(config, [&](const Option& option, const auto& value, const auto&, const char*) {
    json[std::string(option.name)] = value;
  });
  return json;
}

/// Sets the fields that `json` names and leaves the others. Unknown keys, wrong types and values out of range are
/// InputErrors that name `place` and the key.
template <class Config>
void config_from_json(Config& config, const nlohmann::ordered_json& json, const std::string& place) {
  if (!json.is_object())
    input_error(place, ": expected a JSON object with option names as keys, found ", json.type_name());
  std::size_t known = 0;
  visit_fields(config, [&](const Option& option, auto& value, const auto&, const char*) {
    const auto it = json.find(std::string(option.name));
    if (it == json.end()) return;
    ++known;
    using Value = std::decay_t<decltype(value)>;
    const bool fits = std::is_same_v<Value, bool>          ? it->is_boolean()
                      : std::is_same_v<Value, double>      ? it->is_number()
                      : std::is_same_v<Value, std::string> ? it->is_string()
                      : std::is_integral_v<Value>          ? it->is_number_integer()
                                                           : it->is_array();
    if (!fits) input_error(place, ": ", option.name, " has the wrong type: found ", it->dump());
    try {
      value = it->template get<Value>();
    } catch (const nlohmann::json::exception&) {
      input_error(place, ": ", option.name, " has the wrong type: found ", it->dump());
    }
  });
  if (known != json.size()) {
    for (const auto& [key, value] : json.items()) {
      bool found = false;
      visit_fields(config, [&](const Option& option, const auto&, const auto&, const char*) {
        found = found || option.name == key;
      });
      if (!found) input_error(place, ": unknown option \"", key, "\"");
    }
  }
  check_ranges(config, place);
}

/// One line per field that differs: "iterations: 7000 -> 30000".
template <class Config>
std::vector<std::string> config_differences(const Config& before, const Config& after) {
  const nlohmann::ordered_json a = config_to_json(before), b = config_to_json(after);
  std::vector<std::string> lines;
  for (const auto& [key, value] : a.items()) {
    if (b.at(key) != value) lines.push_back(key + ": " + value.dump() + " -> " + b.at(key).dump());
  }
  return lines;
}

}  // namespace b3dgs
