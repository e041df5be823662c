// Command-line parsing and help texts, from the field lists of configs (config.h). Option names are written with
// underscores; hyphens are accepted as well: --test-iterations is --test_iterations.
#pragma once

#include <algorithm>
#include <memory>
#include <string>
#include <string_view>
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

/// The command line of one subcommand, "b3dgs NAME".
class CommandLine {
 public:
  /// The help text begins with `summary` and shows `example`, a complete command, after the usage line.
  CommandLine(const std::string& name, const std::string& summary, const std::string& example = "");
  ~CommandLine();
  CommandLine(const CommandLine&) = delete;
  CommandLine& operator=(const CommandLine&) = delete;

  /// Adds every field of a config. Those before the first Option::group() are listed under `heading` in the help text.
  /// Fields named in `positional` may also be given without their name, in that order. Those in `ignored` are accepted
  /// without effect and not listed, for commands that accept another command's options.
  template <class Config>
  void add(const Config& defaults, const std::string& heading, const std::vector<std::string>& positional = {},
           const std::vector<std::string>& ignored = {}) {
    const auto is_in = [](const std::vector<std::string>& names, std::string_view name) {
      return std::find(names.begin(), names.end(), name) != names.end();
    };
    std::string group = heading;
    visit_fields(defaults, [&](const Option& option, const auto& value, const auto& constraint, const char* help) {
      OptionSpec spec;
      spec.name = option.name;
      spec.letter = option.letter;
      spec.aliases.assign(option.aliases.begin(), option.aliases.end());
      spec.kind = detail::value_kind<std::decay_t<decltype(value)>>();
      spec.help = help;
      spec.range = detail::range_text(constraint);
      spec.lists_choices = std::is_same_v<std::decay_t<decltype(constraint)>, OneOf>;
      spec.default_value = value;
      if (*option.group_name != '\0') group = option.group_name;
      spec.group = group;
      spec.is_common = option.is_common;
      spec.positional = is_in(positional, option.name);
      spec.is_ignored = is_in(ignored, option.name);
      add(spec);
    });
  }

  /// Replaces the help text of an option, where a command treats it differently from the others.
  void set_help(const std::string& name, const std::string& help);

  /// Adds a text to the end of --help-all.
  void set_notes(const std::string& notes);

  /// Parses the words after the command's name. False if they ask for help, which is then printed to standard output.
  /// @throws InputError for an unknown option (suggesting the nearest known one) and for a missing or malformed value
  bool parse(const std::vector<std::string>& words);

  /// Sets the fields of `config` that were given, and leaves the others. @throws InputError if one is out of range
  template <class Config>
  void apply(Config& config) const {
    nlohmann::ordered_json mine = nlohmann::ordered_json::object();
    visit_fields(config, [&](const Option& option, const auto&, const auto&, const char*) {
      if (const auto it = given_.find(std::string(option.name)); it != given_.end()) mine[it.key()] = *it;
    });
    config_from_json(config, mine, /*place=*/"");
  }

  bool was_given(const std::string& name) const { return given_.contains(name); }
  /// All values that were given, by the option's primary name. Not yet checked against the options' ranges.
  const nlohmann::ordered_json& given() const { return given_; }

  /// The text of --help: all options if there are at most kMaxShortHelp, else the common ones.
  std::string help() const;
  /// The text of --help-all: all options, with ranges and aliases.
  std::string help_all() const;
  /// The text of --help-markdown, which is not listed: this command's section of docs/options.md.
  std::string help_markdown() const;

  static constexpr std::size_t kMaxShortHelp = 20;  // options

 private:
  void add(const OptionSpec& spec);

  struct Impl;
  std::unique_ptr<Impl> impl_;
  nlohmann::ordered_json given_ = nlohmann::ordered_json::object();
};

/// Reads a --config file: a JSON object with option names as keys; // comments are allowed. @throws InputError
nlohmann::ordered_json read_json_file(const std::string& path);

/// Sets the fields of `config` that a --config file names. @throws InputError
template <class Config>
void apply_config_file(Config& config, const std::string& path) {
  config_from_json(config, read_json_file(path), path);
}

/// The known name that a mistyped one most likely stands for; empty if none is similar.
std::string nearest_name(const std::string& name, const std::vector<std::string>& known);

}  // namespace b3dgs
