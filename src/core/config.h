// Options as structs. A config is a struct whose members have default values, plus one field list:
//
//   template <class Visitor> void visit_fields(TrainConfig& c, Visitor&& field) {
//     field(Option{"iterations"}.common(), c.iterations, AtLeast{1}, "training iterations");
//   }
//
// The command line, help texts, docs/options.md, JSON input and output, range checks and the list of changed options at
// resume are visitors of that list, so an option is defined in one place. Member types: bool, int, std::int64_t,
// double, std::string, std::vector<int>, std::vector<std::int64_t>, std::vector<double>, std::vector<std::string>, and
// enumerations whose names names_of(E) returns in the order of their values.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <initializer_list>
#include <limits>
#include <nlohmann/json.hpp>
#include <set>
#include <string>
#include <string_view>
#include <type_traits>
#include <vector>

#include "core/check.h"
#include "core/json_text.h"
#include "core/text.h"

namespace b3dgs {

/// Options counted in iterations. kSchedule options shape the training. kOutput options determine when something is
/// measured, logged or saved.
enum class Steps { kNone, kSchedule, kOutput };

/// Names of a field: JSON keys and, with two hyphens, command-line options. '-' and '_' are equivalent in both.
struct Option {
  std::string_view name;                            // "source_path"
  char letter = '\0';                               // 's' for -s, or none
  std::initializer_list<const char*> aliases = {};  // names that other trainers use for this option
  bool is_common = false;
  const char* group_name = "";
  Steps steps = Steps::kNone;
  bool is_empty_allowed = false;

  /// Lists the option in `b3dgs COMMAND --help`, not only in --help-all.
  constexpr Option common() const { return with(&Option::is_common, true); }
  /// Puts this option, and those after it up to the next group(), under a heading in the help text.
  constexpr Option group(const char* heading) const { return with(&Option::group_name, heading); }
  /// Marks the option as counted in iterations.
  constexpr Option in_steps(Steps kind = Steps::kSchedule) const { return with(&Option::steps, kind); }
  /// Allows an empty word for a text option on the command line. Otherwise that is an error, because it usually comes
  /// from a shell variable that is not set.
  constexpr Option may_be_empty() const { return with(&Option::is_empty_allowed, true); }

  template <class Member>
  constexpr Option with(Member Option::*member, Member value) const {
    Option option = *this;
    option.*member = value;
    return option;
  }

  /// Returns whether `key` is one of the option's names, including its letter.
  bool has_name(std::string key) const {
    if (letter != '\0' && key == std::string(1, letter)) return true;
    std::replace(key.begin(), key.end(), '-', '_');
    return key == name || std::any_of(aliases.begin(), aliases.end(), [&](const char* word) { return key == word; });
  }
};

/// The same list for a config that must not be changed. Fields are const.
template <class Config, class Visitor>
std::enable_if_t<std::is_const_v<Config>> visit_fields(Config& config, Visitor&& field) {
  visit_fields(const_cast<std::remove_const_t<Config>&>(config),
               [&](const Option& option, const auto& value, const auto& constraint, const char* help) {
                 field(option, value, constraint, help);
               });
}

namespace detail {

template <class Value>
struct is_vector : std::false_type {};
template <class Entry>
struct is_vector<std::vector<Entry>> : std::true_type {};

inline bool is_among(const std::string& value, const std::vector<std::string>& values) {
  return std::find(values.begin(), values.end(), value) != values.end();
}

}  // namespace detail

// Constraints on the values of a field, and their text, such as "at least 1". In a list, each number must meet them.
struct Any {
  template <class Value>
  bool allows(const Value&) const {
    return true;
  }
  std::string text() const { return ""; }
};
struct AtLeast {
  double min;
  bool allows(double value) const { return value >= min; }
  std::string text() const { return detail::concat("at least ", min); }
};
struct Above {
  double min;
  bool allows(double value) const { return value > min; }
  std::string text() const { return detail::concat("above ", min); }
};
struct InRange {
  double min, max;  // inclusive
  bool allows(double value) const { return value >= min && value <= max; }
  std::string text() const { return detail::concat("from ", min, " to ", max); }
};
struct OneOf {
  std::vector<std::string> values;
  bool allows(const std::string& value) const { return detail::is_among(value, values); }
  std::string text() const { return "one of " + list_text(values); }
};

/// Returns the name of an enumeration's value, as on the command line.
template <class Enum>
std::string name_of(Enum value) {
  return names_of(value)[static_cast<std::size_t>(value)];
}

template <class Enum>
OneOf one_of() {
  const auto names = names_of(Enum{});
  return {{names.begin(), names.end()}};
}

namespace detail {

template <class Value>
nlohmann::ordered_json option_to_json(const Value& value) {
  if constexpr (std::is_enum_v<Value>) {
    return name_of(value);
  } else {
    return value;
  }
}

template <class Constraint, class Value>
bool is_allowed(const Constraint& constraint, const Value& value) {
  if constexpr (is_vector<Value>::value) {
    return std::all_of(value.begin(), value.end(), [&](const auto& entry) { return is_allowed(constraint, entry); });
  } else if constexpr (std::is_enum_v<Value>) {
    return true;
  } else if constexpr (std::is_integral_v<Value>) {
    return constraint.allows(static_cast<double>(value));
  } else {
    return constraint.allows(value);
  }
}

/// Returns " from -2147483648 to 2147483647", for the message about a number that does not fit.
template <class Number>
std::string limits_text() {
  return concat(" from ", std::numeric_limits<Number>::min(), " to ", std::numeric_limits<Number>::max());
}

/// Converts a JSON value without rounding or wrapping. If it does not fit, returns the expected type, such as "a whole
/// number", otherwise an empty text.
template <class Value>
std::string take_json(const nlohmann::ordered_json& json, Value& value) {
  if constexpr (is_vector<Value>::value) {
    if (!json.is_array()) return "a list";
    value.clear();
    for (const auto& item : json) {
      const std::string wanted = take_json(item, value.emplace_back());
      if (!wanted.empty()) return "a list, each entry " + wanted;
    }
    return "";
  } else if constexpr (std::is_enum_v<Value>) {
    if (!json.is_string()) return "a string";
    const auto names = names_of(value);
    const auto found = std::find(names.begin(), names.end(), json.get<std::string>());
    if (found == names.end()) return one_of<Value>().text();
    value = static_cast<Value>(found - names.begin());
    return "";
  } else if constexpr (std::is_same_v<Value, bool>) {
    if (!json.is_boolean()) return "true or false";
  } else if constexpr (std::is_integral_v<Value>) {
    if (!json.is_number_integer()) return "a whole number";
    // A number above the largest std::int64_t is unsigned, and negative after its conversion.
    const auto wide = json.get<std::int64_t>();
    const bool is_too_large = json.is_number_unsigned() && wide < 0;
    if (is_too_large || static_cast<Value>(wide) != wide) return "a whole number" + limits_text<Value>();
  } else if constexpr (std::is_floating_point_v<Value>) {
    if (!json.is_number() || !std::isfinite(json.get<Value>())) return "a number";
  } else {
    if (!json.is_string()) return "a string";
  }
  json.get_to(value);
  return "";
}

/// `place` is the file that the value is from, or empty for the command line.
[[noreturn]] inline void invalid_value(const std::string& place, std::string_view option, const std::string& expected,
                                       const std::string& found) {
  const std::string what = place.empty() ? concat("--", option) : concat(option, ": ", place);
  input_error("invalid value for ", what, " (expected ", expected, ", found ", found, ")");
}

}  // namespace detail

/// Throws an InputError for the first value out of range. `place` is the file that the values are from, or empty for
/// the command line.
template <class Config>
void check_ranges(const Config& config, const std::string& place) {
  visit_fields(config, [&](const Option& option, const auto& value, const auto& constraint, const char*) {
    if (!detail::is_allowed(constraint, value)) {
      detail::invalid_value(place, option.name, constraint.text(), dump_json(value));
    }
  });
}

template <class Config>
nlohmann::ordered_json config_to_json(const Config& config) {
  nlohmann::ordered_json json;
  visit_fields(config, [&](const Option& option, const auto& value, const auto&, const char*) {
    json[std::string(option.name)] = detail::option_to_json(value);
  });
  return json;
}

/// Sets the fields that `json` names, by any of their names, and keeps the others. Throws an InputError with `place` (a
/// file, or empty for the command line) and the key for unknown keys, options given twice, wrong types and values out
/// of range.
template <class Config>
void config_from_json(Config& config, const nlohmann::ordered_json& json, const std::string& place) {
  if (!json.is_object())
    input_error("not a JSON object: ", place, " (expected option names as keys, found ", json.type_name(), ")");
  std::set<std::string> unknown;
  for (const auto& item : json.items()) unknown.insert(item.key());
  visit_fields(config, [&](const Option& option, auto& value, const auto&, const char*) {
    std::string first;
    for (const auto& [key, given] : json.items()) {
      if (!option.has_name(key)) continue;
      if (!first.empty()) {
        input_error("option given twice: ", place, " (\"", first, "\" and \"", key, "\" are the same); remove one");
      }
      first = key;
      unknown.erase(key);
      const std::string wanted = detail::take_json(given, value);
      if (!wanted.empty()) detail::invalid_value(place, option.name, wanted, dump_json(given));
    }
  });
  if (!unknown.empty()) input_error("unknown option \"", *unknown.begin(), "\": ", place);
  check_ranges(config, place);
}

/// Returns one line per field that differs: "iterations: 7000 -> 30000".
template <class Config>
std::vector<std::string> config_differences(const Config& before, const Config& after) {
  const nlohmann::ordered_json a = config_to_json(before), b = config_to_json(after);
  std::vector<std::string> lines;
  for (const auto& [key, value] : a.items()) {
    if (b.at(key) != value) lines.push_back(key + ": " + dump_json(value) + " -> " + dump_json(b.at(key)));
  }
  return lines;
}

}  // namespace b3dgs
