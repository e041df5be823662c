// Command-line parsing, from the field lists of configs (config.h). Option names are written with underscores; hyphens
// are accepted as well: --test-iterations is --test_iterations.
#pragma once

#include <algorithm>
#include <memory>
#include <string>
#include <string_view>
#include <type_traits>
#include <vector>

#include "core/config.h"
#include "core/options/option_spec.h"

namespace b3dgs {

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
      spec.is_empty_allowed = option.is_empty_allowed;
      add(spec);
    });
  }

  void add(const OptionSpec& spec);

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

  /// The texts of --help, --help-all and --help-markdown (help_pages.h). The last is not listed: it is this command's
  /// section of docs/options.md.
  std::string help() const;
  std::string help_all() const;
  std::string help_markdown() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
  nlohmann::ordered_json given_ = nlohmann::ordered_json::object();
};

}  // namespace b3dgs
