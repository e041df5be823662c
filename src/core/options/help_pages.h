// Help texts of a subcommand, and its section of docs/options.md.
#pragma once

#include <string>
#include <vector>

#include "core/options/option_spec.h"

namespace b3dgs {

/// A subcommand as its help pages present it.
struct CommandHelp {
  std::string name;     // "train"
  std::string summary;  // the first lines
  std::string example;  // a complete command, or empty
  std::string notes;    // the end of --help-all, or empty
  std::vector<const OptionSpec*> options;
};

/// "b3dgs train [SOURCE_PATH] [OPTIONS]"
std::string usage_text(const CommandHelp& command);

/// The text of --help: all options if there are at most kMaxShortHelp, else the common ones.
std::string help_text(const CommandHelp& command);
constexpr std::size_t kMaxShortHelp = 20;

/// The text of --help-all: all options, with ranges and aliases.
std::string full_help_text(const CommandHelp& command);

/// The text of --help-markdown.
std::string markdown_help(const CommandHelp& command);

}  // namespace b3dgs
