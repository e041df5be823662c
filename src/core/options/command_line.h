// Parses command lines with the field lists of configs (config.h). Option names are written with underscores, but
// hyphens are accepted too: --test-iterations is --test_iterations.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
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
  enum class Kind { kFlag, kInt, kInt64, kNumber, kText };

  std::string name;
  char letter = '\0';  // or none
  std::vector<std::string> aliases;
  Kind kind = Kind::kFlag;  // of the value, or of a list's entries
  bool is_list = false;
  std::string help;
  std::string range;           // "at least 1", or empty
  bool lists_choices = false;  // `range` lists the possible values
  nlohmann::json default_value;
  std::string group;        // heading in the help text
  bool is_common = false;   // listed by --help, not only by --help-all
  bool positional = false;  // may be given without its name
  bool is_ignored = false;  // accepted without effect, and not listed
  bool is_empty_allowed = false;

  bool is_flag() const { return kind == Kind::kFlag; }
  /// Returns whether this is the option's name or an alias.
  bool has_name(const std::string& word) const { return word == name || detail::is_among(word, aliases); }

  template <class Value>
  void set_type() {
    if constexpr (detail::is_vector<Value>::value) {
      set_type<typename Value::value_type>();
      is_list = true;
    } else {
      kind = std::is_same_v<Value, bool>           ? Kind::kFlag
             : std::is_same_v<Value, int>          ? Kind::kInt
             : std::is_same_v<Value, std::int64_t> ? Kind::kInt64
             : std::is_same_v<Value, double>       ? Kind::kNumber
                                                   : Kind::kText;
      static_assert(std::is_same_v<Value, bool> || std::is_same_v<Value, int> || std::is_same_v<Value, std::int64_t> ||
                    std::is_same_v<Value, double> || std::is_same_v<Value, std::string> || std::is_enum_v<Value>);
    }
  }
};

/// The command line of one subcommand, "b3dgs NAME".
class CommandLine {
 public:
  /// The help text begins with `summary` and shows `example`, a complete command, after the usage line.
  CommandLine(std::string name, std::string summary, std::string example = "")
      : name_(std::move(name)), summary_(std::move(summary)), example_(std::move(example)) {}

  /// Adds every field of a config. Those before the first Option::group() are listed under `heading` in the help text.
  /// Fields named in `positional` may also be given without their name, in that order. Those in `ignored` are accepted
  /// without effect and not listed, for commands that accept another command's options. If the config is not const,
  /// parse() sets its fields, so it must live until then.
  template <class Config>
  void add(Config&& defaults, const std::string& heading, const std::vector<std::string>& positional = {},
           const std::vector<std::string>& ignored = {});

  void add(const OptionSpec& spec) { options_.push_back(spec); }

  /// Replaces the help text of an option that a command treats differently.
  void set_help(const std::string& name, const std::string& help);

  /// Adds a text to the end of --help-all.
  void set_notes(const std::string& notes) { notes_ = notes; }

  /// Parses the words after the command's name. If they ask for help, prints it to standard output and returns false.
  /// @throws InputError for an unknown option (suggesting the nearest known one), for a missing or malformed value, and
  /// for one that is out of the range of a config
  bool parse(std::vector<std::string> words);

  /// Sets the fields of `config` that were given, and keeps the others. @throws InputError if one is out of range
  template <class Config>
  void apply(Config& config) const {
    nlohmann::ordered_json mine = nlohmann::ordered_json::object();
    visit_fields(config, [&](const Option& option, const auto&, const auto&, const char*) {
      if (const auto it = given_.find(std::string(option.name)); it != given_.end()) mine[it.key()] = *it;
    });
    config_from_json(config, mine, /*place=*/"");
  }

  bool was_given(const std::string& name) const { return given_.contains(name); }
  /// Returns all given values by primary option name, not yet checked against the options' ranges.
  const nlohmann::ordered_json& given() const { return given_; }

  /// Returns the text of --help: all options if there are at most kMaxShortHelp, otherwise the common ones.
  std::string help() const;
  static constexpr std::size_t kMaxShortHelp = 20;
  /// Returns the text of --help-all: all options, with ranges and aliases.
  std::string help_all() const;
  /// Returns the text of --help-markdown, which is not listed: this command's section of docs/options.md.
  std::string help_markdown() const;

 private:
  std::string usage() const;         // "b3dgs train [SOURCE_PATH] [OPTIONS]"
  std::string introduction() const;  // summary, usage and example
  /// Returns the options for the help pages by group, in the order in which the groups begin.
  std::vector<const OptionSpec*> listed(bool only_common = false) const;
  bool prints_help(const std::vector<std::string>& words) const;
  [[noreturn]] void reject(const std::string& word) const;

  std::string name_, summary_, example_, notes_;
  std::vector<OptionSpec> options_;
  std::vector<std::function<void()>> setters_;
  nlohmann::ordered_json given_ = nlohmann::ordered_json::object();
};

/// Reads a --config file or another file that a user may have written, so // comments are allowed. `expected` describes
/// the file in errors. @throws InputError
nlohmann::ordered_json read_json_file(const std::string& path,
                                      const char* expected = "a JSON file with option names as keys");

/// Returns the value as on the command line: "none" for an empty text or list, "on" or "off" for a flag.
std::string option_value_text(const nlohmann::ordered_json& value);

template <class Config>
void CommandLine::add(Config&& defaults, const std::string& heading, const std::vector<std::string>& positional,
                      const std::vector<std::string>& ignored) {
  if constexpr (std::is_lvalue_reference_v<Config> && !std::is_const_v<std::remove_reference_t<Config>>) {
    setters_.push_back([this, &defaults] { apply(defaults); });
  }
  std::string group = heading;
  visit_fields(std::as_const(defaults),
               [&](const Option& option, const auto& value, const auto& constraint, const char* help) {
                 if (*option.group_name != '\0') group = option.group_name;
                 OptionSpec spec;
                 spec.set_type<std::decay_t<decltype(value)>>();
                 spec.name = option.name;
                 spec.letter = option.letter;
                 spec.aliases.assign(option.aliases.begin(), option.aliases.end());
                 spec.help = help;
                 spec.range = constraint.text();
                 spec.lists_choices = std::is_same_v<std::decay_t<decltype(constraint)>, OneOf>;
                 spec.default_value = detail::option_to_json(value);
                 spec.group = group;
                 spec.is_common = option.is_common;
                 spec.positional = detail::is_among(spec.name, positional);
                 spec.is_ignored = detail::is_among(spec.name, ignored);
                 spec.is_empty_allowed = option.is_empty_allowed;
                 add(spec);
               });
}

/// Returns the known name that a mistyped one most likely stands for, or an empty text if none is similar.
std::string nearest_name(const std::string& name, const std::vector<std::string>& known);

}  // namespace b3dgs
