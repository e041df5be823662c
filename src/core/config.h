// Options as structs. A config is a struct whose members have default values, plus one field list:
//
//   template <class Visitor> void visit_fields(TrainConfig& c, Visitor&& field) {
//     field(Option{"iterations"}.common(), c.iterations, AtLeast{1}, "training iterations");
//   }
//
// The command line, help texts, docs/options.md, JSON input and output, range checks and the list of changed options at
// resume are visitors of that list, so an option is defined in one place. Member types: bool, int, std::int64_t,
// double, std::string, std::vector<int>, std::vector<std::int64_t>, std::vector<double>, std::vector<std::string>.
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

#include "core/check.h"

namespace b3dgs {

/// Options counted in iterations: those that shape the training, and those that say when something is measured, logged
/// or saved.
enum class Steps { kNone, kSchedule, kOutput };

/// Names of a field: JSON keys, and with two hyphens, command-line options. '-' and '_' are equivalent in both.
struct Option {
  std::string_view name;                            // "source_path"
  char letter = '\0';                               // 's' for -s, or none
  std::initializer_list<const char*> aliases = {};  // what other trainers call this option
  bool is_common = false;
  const char* group_name = "";
  Steps steps = Steps::kNone;
  bool is_empty_allowed = false;

  /// Lists the option in `b3dgs COMMAND --help`, not only in --help-all.
  constexpr Option common() const {
    Option option = *this;
    option.is_common = true;
    return option;
  }
  /// Puts this option, and those after it up to the next group(), under a heading in the help text.
  constexpr Option group(const char* heading) const {
    Option option = *this;
    option.group_name = heading;
    return option;
  }

  /// The option is counted in iterations.
  constexpr Option in_steps(Steps kind = Steps::kSchedule) const {
    Option option = *this;
    option.steps = kind;
    return option;
  }

  /// On the command line, a text option may be the empty word. Otherwise that is an error, since it is usually the
  /// value of a shell variable that is not set.
  constexpr Option may_be_empty() const {
    Option option = *this;
    option.is_empty_allowed = true;
    return option;
  }

  /// Whether `key` is one of the option's names, including its letter.
  bool has_name(std::string key) const {
    if (letter != '\0' && key == std::string(1, letter)) return true;
    std::replace(key.begin(), key.end(), '-', '_');
    return key == name || std::any_of(aliases.begin(), aliases.end(), [&](const char* word) { return key == word; });
  }
};

/// The same list for a config that is not to be changed: fields are const.
template <class Config, class Visitor>
std::enable_if_t<std::is_const_v<Config>> visit_fields(Config& config, Visitor&& field) {
  visit_fields(const_cast<std::remove_const_t<Config>&>(config),
               [&](const Option& option, const auto& value, const auto& constraint, const char* help) {
                 field(option, value, constraint, help);
               });
}

struct Any {};
struct AtLeast {
  double min;
};
struct Above {
  double min;
};
struct InRange {
  double min, max;  // inclusive
};
struct OneOf {
  std::vector<std::string> values;
};
/// For a list of names: at least `least` of them, without repetition.
struct SomeOf {
  std::vector<std::string> values;
  std::size_t least = 1;
};

/// The values that a constraint allows, such as "at least 1"; empty if `value` is one of them.
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
  return detail::concat(choice.least, " or more different names out of ", names);
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

namespace detail {

template <class Value>
struct is_vector : std::false_type {};
template <class Entry>
struct is_vector<std::vector<Entry>> : std::true_type {};

/// " from -2147483648 to 2147483647", for the message about a number that does not fit.
template <class Number>
std::string limits_text() {
  return concat(" from ", std::numeric_limits<Number>::min(), " to ", std::numeric_limits<Number>::max());
}

/// Converts a JSON value without rounding or wrapping. False if it does not fit.
template <class Value>
bool take_json(const nlohmann::ordered_json& json, Value& value) {
  if constexpr (is_vector<Value>::value) {
    if (!json.is_array()) return false;
    value.clear();
    for (const auto& item : json) {
      typename Value::value_type entry{};
      if (!take_json(item, entry)) return false;
      value.push_back(std::move(entry));
    }
    return true;
  } else if constexpr (std::is_same_v<Value, bool>) {
    return json.is_boolean() && (json.get_to(value), true);
  } else if constexpr (std::is_integral_v<Value>) {
    constexpr std::uint64_t kMax64 = std::numeric_limits<std::int64_t>::max();
    if (!json.is_number_integer()) return false;
    if (json.is_number_unsigned() && json.get<std::uint64_t>() > kMax64) return false;
    const auto wide = json.get<std::int64_t>();
    value = static_cast<Value>(wide);
    return value == wide;
  } else if constexpr (std::is_floating_point_v<Value>) {
    return json.is_number() && std::isfinite(json.get_to(value));
  } else {
    return json.is_string() && (json.get_to(value), true);
  }
}

/// What take_json() accepts for a field of type Value, given that it rejected `found`: "a whole number".
template <class Value>
std::string expected_json(const nlohmann::ordered_json& found) {
  if constexpr (is_vector<Value>::value) {
    using Entry = typename Value::value_type;
    Entry entry{};
    const auto bad =
        std::find_if(found.begin(), found.end(), [&](const auto& item) { return !take_json(item, entry); });
    return "a list" + (found.is_array() ? ", each entry " + expected_json<Entry>(*bad) : "");
  } else if constexpr (std::is_same_v<Value, bool>) {
    return "true or false";
  } else if constexpr (std::is_integral_v<Value>) {
    return "a whole number" + (found.is_number_integer() ? limits_text<Value>() : "");
  } else if constexpr (std::is_floating_point_v<Value>) {
    return "a number";
  } else {
    return "a string";
  }
}

/// `place` is the file that the value is from; empty: the command line.
[[noreturn]] inline void invalid_value(const std::string& place, std::string_view option, const std::string& expected,
                                       const std::string& found) {
  const std::string what = place.empty() ? concat("--", option) : concat(option, ": ", place);
  input_error("invalid value for ", what, " (expected ", expected, ", found ", found, ")");
}

}  // namespace detail

/// Throws an InputError for the first value out of range. `place` is the file that the values are from; empty: the
/// command line.
template <class Config>
void check_ranges(const Config& config, const std::string& place) {
  visit_fields(config, [&](const Option& option, const auto& value, const auto& constraint, const char*) {
    using Constraint = std::decay_t<decltype(constraint)>;
    if constexpr (!std::is_same_v<Constraint, Any>) {
      if (std::string wanted = violation(constraint, value); !wanted.empty()) {
        detail::invalid_value(place, option.name, wanted, nlohmann::json(value).dump());
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

/// Sets the fields that `json` names, by any of their names, and leaves the others unchanged. Throws an InputError with
/// `place` (a file; empty: the command line) and the key for unknown keys, options given twice, wrong types and values
/// out of range.
template <class Config>
void config_from_json(Config& config, const nlohmann::ordered_json& json, const std::string& place) {
  if (!json.is_object())
    input_error("not a JSON object: ", place, " (expected option names as keys, found ", json.type_name(), ")");
  std::size_t n_known = 0;
  visit_fields(config, [&](const Option& option, auto& value, const auto&, const char*) {
    std::string first;
    for (const auto& [key, given] : json.items()) {
      if (!option.has_name(key)) continue;
      if (!first.empty()) {
        input_error("option given twice: ", place, " (\"", first, "\" and \"", key, "\" are the same); remove one");
      }
      first = key;
      ++n_known;
      using Value = std::decay_t<decltype(value)>;
      if (!detail::take_json(given, value)) {
        detail::invalid_value(place, option.name, detail::expected_json<Value>(given), given.dump());
      }
    }
  });
  if (n_known != json.size()) {
    for (const auto& [key, value] : json.items()) {
      bool is_known = false;
      visit_fields(config, [&, &name = key](const Option& option, const auto&, const auto&, const char*) {
        is_known = is_known || option.has_name(name);
      });
      if (!is_known) input_error("unknown option \"", key, "\": ", place);
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
