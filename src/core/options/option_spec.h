// What the parser and the help pages need to know of one option.
#pragma once

#include <cstdint>
#include <limits>
#include <string>
#include <type_traits>
#include <vector>

#include "core/config.h"

namespace b3dgs {

/// Type of the value after an option.
enum class ValueKind { kFlag, kInt, kInt64, kNumber, kText, kInts, kInt64s, kNumbers, kNames };

/// One option, for the parser and the help texts.
struct OptionSpec {
  std::string name;
  char letter = '\0';  // or none
  std::vector<std::string> aliases;
  ValueKind kind = ValueKind::kText;
  std::string help;
  std::string range;           // "at least 1", or empty
  bool lists_choices = false;  // `range` lists the possible values
  nlohmann::json default_value;
  std::string group;        // heading in the help text
  bool is_common = false;   // listed by --help, not only by --help-all
  bool positional = false;  // may be given without its name
  bool is_ignored = false;  // accepted without effect, and not listed
  bool is_empty_allowed = false;
};

inline bool is_list(const OptionSpec& spec) {
  return spec.kind == ValueKind::kInts || spec.kind == ValueKind::kInt64s || spec.kind == ValueKind::kNumbers ||
         spec.kind == ValueKind::kNames;
}

namespace detail {

template <class Value>
constexpr ValueKind value_kind() {
  if constexpr (std::is_same_v<Value, bool>) return ValueKind::kFlag;
  if constexpr (std::is_same_v<Value, int>) return ValueKind::kInt;
  if constexpr (std::is_same_v<Value, std::int64_t>) return ValueKind::kInt64;
  if constexpr (std::is_same_v<Value, double>) return ValueKind::kNumber;
  if constexpr (std::is_same_v<Value, std::vector<int>>) return ValueKind::kInts;
  if constexpr (std::is_same_v<Value, std::vector<std::int64_t>>) return ValueKind::kInt64s;
  if constexpr (std::is_same_v<Value, std::vector<double>>) return ValueKind::kNumbers;
  if constexpr (std::is_same_v<Value, std::vector<std::string>>) return ValueKind::kNames;
  return ValueKind::kText;
}

/// What the constraint allows: the complaint about a value that violates it, which NaN and an empty string always do.
template <class Constraint>
std::string range_text(const Constraint& constraint) {
  if constexpr (std::is_same_v<Constraint, Any>) {
    return "";
  } else if constexpr (std::is_same_v<Constraint, OneOf>) {
    return violation(constraint, std::string());
  } else if constexpr (std::is_same_v<Constraint, SomeOf>) {
    return violation(constraint, std::vector<std::string>());
  } else {
    return violation(constraint, std::numeric_limits<double>::quiet_NaN());
  }
}

}  // namespace detail

}  // namespace b3dgs
