// Help texts of a subcommand, and its section of docs/options.md.
#include <algorithm>
#include <cctype>
#include <sstream>
#include <utility>

#include "core/options/command_line.h"

namespace b3dgs {
namespace {

// Columns of the help text.
constexpr std::size_t kNameColumns = 36;
constexpr std::size_t kTextColumns = 84;

/// Breaks the text at blanks into lines of at most `columns`, each but the first indented by `indent`.
std::string wrap(const std::string& text, std::size_t columns, std::size_t indent) {
  std::istringstream words(text);
  std::string wrapped, word;
  std::size_t used = 0;
  while (words >> word) {
    if (used > 0 && used + 1 + word.size() > columns) {
      wrapped += '\n' + std::string(indent, ' ');
      used = 0;
    }
    if (used > 0) wrapped += ' ', ++used;
    wrapped += word;
    used += word.size();
  }
  return wrapped;
}

/// "--a, --b", or in Markdown "`--a`, `--b`".
std::string alias_list(const OptionSpec& spec, const std::string& quote = "") {
  std::string text;
  for (const std::string& name : spec.aliases) text += (text.empty() ? "" : ", ") + quote + "--" + name + quote;
  return text;
}

/// A default value as one would type it; empty for an empty text and for a flag that is off.
std::string value_text(const nlohmann::json& value) {
  if (value.is_boolean()) return value.get<bool>() ? "on" : "";
  if (value.is_string()) return value.get<std::string>();
  if (value.is_array()) {
    std::string text;
    for (const nlohmann::json& entry : value) text += (text.empty() ? "" : " ") + value_text(entry);
    return text.empty() ? "none" : text;
  }
  const std::string text = value.dump();
  const bool is_whole = text.size() > 2 && text.compare(text.size() - 2, 2, ".0") == 0;
  return is_whole ? text.substr(0, text.size() - 2) : text;
}

enum class HelpDetail { kShort, kAll };

/// "training iterations (default 30000; at least 1; also --max_steps)"; a short one leaves out ranges and aliases.
std::string description(const OptionSpec& spec, HelpDetail detail) {
  std::vector<std::string> notes;
  if (const std::string text = value_text(spec.default_value); !text.empty()) notes.push_back("default " + text);
  if (spec.default_value == true) notes.push_back("--no_" + spec.name + " turns it off");
  if (!spec.range.empty() && (detail == HelpDetail::kAll || spec.lists_choices)) notes.push_back(spec.range);
  if (detail == HelpDetail::kAll && !spec.aliases.empty()) notes.push_back("also " + alias_list(spec));
  if (notes.empty()) return spec.help;
  // A note at the end of the help text, "(0 = never)", and these share one pair of parentheses.
  const bool has_note = !spec.help.empty() && spec.help.back() == ')' && spec.help.find(" (") != std::string::npos;
  std::string text = has_note ? spec.help.substr(0, spec.help.size() - 1) + "; " : spec.help + " (";
  for (std::size_t i = 0; i < notes.size(); ++i) text += (i == 0 ? "" : "; ") + notes[i];
  return text + ")";
}

/// "-s, --source_path TEXT"; without a letter, indented as if there were one.
std::string names_and_value(const OptionSpec& spec) {
  const std::string value = spec.value_name == "TEXT" && !spec.range.empty() ? "NAME" : spec.value_name;
  return (spec.letter == '\0' ? "    " : std::string("-") + spec.letter + ", ") + "--" + spec.name +
         (value.empty() ? "" : " " + value);
}

/// One option of a help text, its description starting at a fixed column.
std::string help_entry(const OptionSpec& spec, HelpDetail detail) {
  const std::string names = "  " + names_and_value(spec);
  const bool fits = names.size() + 2 <= kNameColumns;
  const std::string space =
      fits ? std::string(kNameColumns - names.size(), ' ') : "\n" + std::string(kNameColumns, ' ');
  return names + space + wrap(description(spec, detail), kTextColumns, kNameColumns) + "\n";
}

/// A cell of a Markdown table.
std::string cell(std::string text) {
  for (std::size_t at = 0; (at = text.find('|', at)) != std::string::npos; at += 2) text.insert(at, 1, '\\');
  return " " + text + " |";
}

std::string markdown_row(const OptionSpec& spec) {
  std::string names = spec.letter == '\0' ? "" : std::string("`-") + spec.letter + "`";
  if (!spec.aliases.empty()) names += (names.empty() ? "" : ", ") + alias_list(spec, "`");
  const std::string value = value_text(spec.default_value);
  return "|" + cell("`--" + spec.name + "`") + cell(names) + cell(spec.is_flag() && value.empty() ? "off" : value) +
         cell(spec.is_flag() ? "flag" : spec.range) + cell(spec.help) + "\n";
}

/// The options by group, in the order in which the groups begin.
std::vector<std::pair<std::string, std::vector<const OptionSpec*>>> grouped(const std::vector<const OptionSpec*>& all) {
  std::vector<std::pair<std::string, std::vector<const OptionSpec*>>> groups;
  for (const OptionSpec* spec : all) {
    const auto same = [&](const auto& group) { return group.first == spec->group; };
    auto group = std::find_if(groups.begin(), groups.end(), same);
    if (group == groups.end()) group = groups.insert(groups.end(), {spec->group, {}});
    group->second.push_back(spec);
  }
  return groups;
}

std::string list_options(const std::vector<const OptionSpec*>& options, HelpDetail detail) {
  std::string text;
  for (const auto& [group, specs] : grouped(options)) {
    text += "\n" + group + ":\n";
    for (const OptionSpec* spec : specs) text += help_entry(*spec, detail);
  }
  return text;
}

}  // namespace

std::vector<const OptionSpec*> CommandLine::listed() const {
  std::vector<const OptionSpec*> options;
  for (const OptionSpec& spec : options_) {
    if (!spec.is_ignored) options.push_back(&spec);
  }
  return options;
}

std::string CommandLine::usage() const {
  std::string text = "b3dgs " + name_;
  for (const OptionSpec* spec : listed()) {
    if (!spec->positional) continue;
    std::string name = spec->name;
    std::transform(name.begin(), name.end(), name.begin(), [](unsigned char c) { return std::toupper(c); });
    text += " [" + name + "]";
  }
  return text + " [OPTIONS]";
}

std::string CommandLine::introduction() const {
  return wrap(summary_, kNameColumns + kTextColumns, 0) + "\n\nUsage: " + usage() + "\n" +
         (example_.empty() ? "" : "Example: " + example_ + "\n");
}

std::string CommandLine::help() const {
  std::vector<const OptionSpec*> options = listed();
  const std::size_t n_all = options.size();
  const bool is_short_list = n_all <= kMaxShortHelp;
  if (!is_short_list) {
    options.erase(std::remove_if(options.begin(), options.end(), [](const auto* spec) { return !spec->is_common; }),
                  options.end());
  }
  return introduction() + list_options(options, HelpDetail::kShort) + "\nb3dgs " + name_ + " --help-all" +
         (is_short_list ? " adds ranges and aliases.\n" : " lists all " + std::to_string(n_all) + " options.\n");
}

std::string CommandLine::help_all() const {
  return introduction() + list_options(listed(), HelpDetail::kAll) + (notes_.empty() ? "" : "\n" + notes_);
}

std::string CommandLine::help_markdown() const {
  std::string text = "## b3dgs " + name_ + "\n\n" + wrap(summary_, 100, 0) + "\n";
  if (!example_.empty()) text += "\n    " + example_ + "\n";
  for (const auto& [group, specs] : grouped(listed())) {
    text += "\n### " + group + "\n\n| Option | Also | Default | Range | Meaning |\n|---|---|---|---|---|\n";
    for (const OptionSpec* spec : specs) text += markdown_row(*spec);
  }
  return text + "\n";
}

}  // namespace b3dgs
