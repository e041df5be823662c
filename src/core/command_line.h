// Command lines from the field lists of configs (config.h): names, help, conversion and range checks all follow from
// the list. Underscores are canonical in names, hyphens are accepted everywhere: --test-iterations is
// --test_iterations.
#pragma once

#include <memory>
#include <string>
#include <type_traits>
#include <vector>

#include "core/config.h"

namespace b3dgs {

/// What the words after an option stand for.
enum class ValueKind { kFlag, kInt, kInt64, kNumber, kText, kInts, kInt64s, kNumbers, kNames };

/// One option as help text and parser need it.
struct OptionSpec {
  Option option;
  ValueKind kind = ValueKind::kText;
  std::string help;
  std::string range;  // "at least 1", or empty
  nlohmann::json default_value;
  bool positional = false;  // may be given without its name
  bool unused = false;      // accepted, but not in the help text
};

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

/// Not a number violates every numeric range, and the empty string every choice: what is wanted then is the range.
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

/// The command line of one subcommand.
class CommandLine {
 public:
  /// `name` as in "b3dgs NAME"; `summary` opens the help text.
  CommandLine(const std::string& name, const std::string& summary);
  ~CommandLine();
  CommandLine(const CommandLine&) = delete;
  CommandLine& operator=(const CommandLine&) = delete;

  /// Adds every field of a config, under `heading` in the help text. Fields named in `positional` may also be given
  /// without their name, in the order of the list. Those in `unused` are taken, without effect, and not in the help
  /// text: for commands that take the options of another.
  template <class Config>
  void add(const Config& defaults, const std::string& heading, const std::vector<std::string>& positional = {},
           const std::vector<std::string>& unused = {}) {
    visit_fields(defaults, [&](const Option& option, const auto& value, const auto& constraint, const char* help) {
      OptionSpec spec;
      spec.option = option;
      spec.kind = detail::value_kind<std::decay_t<decltype(value)>>();
      spec.help = help;
      spec.range = detail::range_text(constraint);
      spec.default_value = value;
      for (const std::string& name : positional) spec.positional = spec.positional || name == option.name;
      for (const std::string& name : unused) spec.unused = spec.unused || name == option.name;
      add(spec, heading);
    });
  }

  /// Reads the words after the command's name. False: help was asked for, and has been printed.
  /// @throws InputError for an unknown option (naming the nearest known one) and for a missing or malformed value
  bool parse(const std::vector<std::string>& words);

  /// Sets the fields of `config` that were given and leaves the others. @throws InputError if one is out of range
  template <class Config>
  void apply(Config& config) const {
    nlohmann::ordered_json mine = nlohmann::ordered_json::object();
    visit_fields(config, [&](const Option& option, const auto&, const auto&, const char*) {
      if (const auto it = given_.find(std::string(option.name)); it != given_.end()) mine[it.key()] = *it;
    });
    config_from_json(config, mine, "command line");
  }

  bool was_given(const std::string& name) const { return given_.contains(name); }

  /// What --help prints.
  std::string help() const;

 private:
  void add(const OptionSpec& spec, const std::string& heading);

  struct Impl;
  std::unique_ptr<Impl> impl_;
  nlohmann::ordered_json given_ = nlohmann::ordered_json::object();
};

/// Reads a --config file: an object with option names as keys; // comments are allowed. @throws InputError
nlohmann::ordered_json read_json_file(const std::string& path);

/// Sets the fields of `config` that a --config file names.
template <class Config>
void apply_config_file(Config& config, const std::string& path) {
  config_from_json(config, read_json_file(path), path);
}

/// The known name nearest to a mistyped one, or "" if none is near.
std::string nearest_name(const std::string& name, const std::vector<std::string>& known);

}  // namespace b3dgs
