// Command-line parsing, from the field lists of configs (config.h). Option names are written with underscores; hyphens
// are accepted as well: --test-iterations is --test_iterations.
#pragma once

#include <algorithm>
#include <cstddef>
#include <functional>
#include <limits>
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>
#include <vector>

#include "core/config.h"

namespace b3dgs {

/// One option, as the parser and the help pages see it.
struct OptionSpec {
  using Words = std::vector<std::string>;

  std::string name;
  char letter = '\0';  // or none
  std::vector<std::string> aliases;
  std::string value_name;  // "N", for the help; empty: a flag
  bool is_list = false;
  /// The value that these words stand for. Throws an InputError that names the option.
  nlohmann::json (*parse)(const OptionSpec& spec, const Words& words) = nullptr;
  std::string help;
  std::string range;           // "at least 1", or empty
  bool lists_choices = false;  // `range` lists the possible values
  nlohmann::json default_value;
  std::string group;        // heading in the help text
  bool is_common = false;   // listed by --help, not only by --help-all
  bool positional = false;  // may be given without its name
  bool is_ignored = false;  // accepted without effect, and not listed
  bool is_empty_allowed = false;

  bool is_flag() const { return value_name.empty(); }
  /// Whether this is the option's name or an alias.
  bool has_name(const std::string& word) const {
    return word == name || std::find(aliases.begin(), aliases.end(), word) != aliases.end();
  }

  /// With the fields that follow from the type of the value.
  template <class Value>
  static OptionSpec of_type();
};

/// The command line of one subcommand, "b3dgs NAME".
class CommandLine {
 public:
  /// The help text begins with `summary` and shows `example`, a complete command, after the usage line.
  CommandLine(std::string name, std::string summary, std::string example = "")
      : name_(std::move(name)), summary_(std::move(summary)), example_(std::move(example)) {}

  /// Adds every field of a config. Those before the first Option::group() are listed under `heading` in the help text.
  /// Fields named in `positional` may also be given without their name, in that order. Those in `ignored` are accepted
  /// without effect and not listed, for commands that accept another command's options. parse() sets the fields of a
  /// config that may be changed, which must then still be there.
  template <class Config>
  void add(Config&& defaults, const std::string& heading, const std::vector<std::string>& positional = {},
           const std::vector<std::string>& ignored = {});

  void add(const OptionSpec& spec) { options_.push_back(spec); }

  /// Replaces the help text of an option, where a command treats it differently from the others.
  void set_help(const std::string& name, const std::string& help);

  /// Adds a text to the end of --help-all.
  void set_notes(const std::string& notes) { notes_ = notes; }

  /// Parses the words after the command's name. False if they ask for help, which is then printed to standard output.
  /// @throws InputError for an unknown option (suggesting the nearest known one), for a missing or malformed value, and
  /// for one that is out of the range of a config to be set
  bool parse(std::vector<std::string> words);

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
  static constexpr std::size_t kMaxShortHelp = 20;
  /// The text of --help-all: all options, with ranges and aliases.
  std::string help_all() const;
  /// The text of --help-markdown, which is not listed: this command's section of docs/options.md.
  std::string help_markdown() const;

 private:
  std::string usage() const;         // "b3dgs train [SOURCE_PATH] [OPTIONS]"
  std::string introduction() const;  // summary, usage and example
  std::vector<const OptionSpec*> listed() const;
  bool prints_help(const std::vector<std::string>& words) const;
  [[noreturn]] void reject(const std::string& word) const;

  std::string name_, summary_, example_, notes_;
  std::vector<OptionSpec> options_;
  std::vector<std::function<void()>> setters_;
  nlohmann::ordered_json given_ = nlohmann::ordered_json::object();
};

/// Reads a --config file, or another that a user may have written: // comments are allowed. `expected`: what it should
/// be, in errors. @throws InputError
nlohmann::ordered_json read_json_file(const std::string& path,
                                      const char* expected = "a JSON file with option names as keys");

namespace detail {

/// Instantiated for the types of fields.
template <class Value>
nlohmann::json parse_value(const OptionSpec& spec, const std::vector<std::string>& words);

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

template <class Value>
OptionSpec OptionSpec::of_type() {
  OptionSpec spec;
  spec.parse = detail::parse_value<Value>;
  if constexpr (detail::is_vector<Value>::value) {
    spec.is_list = true;
    spec.value_name = std::is_same_v<Value, std::vector<std::string>>
                          ? "NAME..."
                          : of_type<typename Value::value_type>().value_name + "...";
  } else if constexpr (!std::is_same_v<Value, bool>) {
    spec.value_name = std::is_integral_v<Value> ? "N" : std::is_floating_point_v<Value> ? "X" : "TEXT";
  }
  return spec;
}

template <class Config>
void CommandLine::add(Config&& defaults, const std::string& heading, const std::vector<std::string>& positional,
                      const std::vector<std::string>& ignored) {
  if constexpr (std::is_lvalue_reference_v<Config> && !std::is_const_v<std::remove_reference_t<Config>>) {
    setters_.push_back([this, &defaults] { apply(defaults); });
  }
  std::string group = heading;
  visit_fields(std::as_const(defaults),
               [&](const Option& option, const auto& value, const auto& constraint, const char* help) {
                 const auto is_in = [&](const std::vector<std::string>& names) {
                   return std::find(names.begin(), names.end(), option.name) != names.end();
                 };
                 OptionSpec spec = OptionSpec::of_type<std::decay_t<decltype(value)>>();
                 spec.name = option.name;
                 spec.letter = option.letter;
                 spec.aliases.assign(option.aliases.begin(), option.aliases.end());
                 spec.help = help;
                 spec.range = detail::range_text(constraint);
                 spec.lists_choices = std::is_same_v<std::decay_t<decltype(constraint)>, OneOf>;
                 spec.default_value = value;
                 if (*option.group_name != '\0') group = option.group_name;
                 spec.group = group;
                 spec.is_common = option.is_common;
                 spec.positional = is_in(positional);
                 spec.is_ignored = is_in(ignored);
                 spec.is_empty_allowed = option.is_empty_allowed;
                 add(spec);
               });
}

/// The known name that a mistyped one most likely stands for; empty if none is similar.
std::string nearest_name(const std::string& name, const std::vector<std::string>& known);

/// The known name of what other trainers call by this name ("output", "total_steps"); empty if there is none.
std::string name_of_other_trainers(const std::string& name, const std::vector<std::string>& known);

}  // namespace b3dgs
