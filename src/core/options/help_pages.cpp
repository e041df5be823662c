#include "core/options/help_pages.h"

#include <algorithm>
#include <cctype>
#include <sstream>
#include <utility>

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
  const bool has_note = !spec.help.empty() && spec.help.back() == ')';
  std::string text = has_note ? spec.help.substr(0, spec.help.size() - 1) + "; " : spec.help + " (";
  for (std::size_t i = 0; i < notes.size(); ++i) text += (i == 0 ? "" : "; ") + notes[i];
  return text + ")";
}

const char* value_name(const OptionSpec& spec) {
  switch (spec.kind) {
    case ValueKind::kFlag:
      return "";
    case ValueKind::kInt:
    case ValueKind::kInt64:
      return "N";
    case ValueKind::kNumber:
      return "X";
    case ValueKind::kInts:
    case ValueKind::kInt64s:
      return "N...";
    case ValueKind::kNumbers:
      return "X...";
    case ValueKind::kNames:
      return "NAME...";
    case ValueKind::kText:
      return spec.range.empty() ? "TEXT" : "NAME";
  }
  return "";
}

/// "-s, --source_path TEXT"; without a letter, indented as if there were one.
std::string names_and_value(const OptionSpec& spec) {
  const std::string value = value_name(spec);
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
  const bool is_flag = spec.kind == ValueKind::kFlag;
  return "|" + cell("`--" + spec.name + "`") + cell(names) + cell(is_flag && value.empty() ? "off" : value) +
         cell(is_flag ? "flag" : spec.range) + cell(spec.help) + "\n";
}

/// Calls `visit(group, specs)` for each group of options that `is_wanted`, in the order in which the groups begin.
template <class Wanted, class Visit>
void for_each_group(const CommandHelp& command, Wanted&& is_wanted, Visit&& visit) {
  std::vector<std::pair<std::string, std::vector<const OptionSpec*>>> groups;
  for (const OptionSpec* spec : command.options) {
    if (!is_wanted(*spec)) continue;
    const auto same = [&](const auto& group) { return group.first == spec->group; };
    auto group = std::find_if(groups.begin(), groups.end(), same);
    if (group == groups.end()) group = groups.insert(groups.end(), {spec->group, {}});
    group->second.push_back(spec);
  }
  for (const auto& [group, specs] : groups) visit(group, specs);
}

/// Summary, usage and example.
std::string introduction(const CommandHelp& command) {
  const std::string text =
      wrap(command.summary, kNameColumns + kTextColumns, 0) + "\n\nUsage: " + usage_text(command) + "\n";
  return command.example.empty() ? text : text + "Example: " + command.example + "\n";
}

template <class Wanted>
std::string list_options(const CommandHelp& command, Wanted&& is_wanted, HelpDetail detail) {
  std::string text = introduction(command);
  for_each_group(command, is_wanted, [&](const std::string& group, const std::vector<const OptionSpec*>& specs) {
    text += "\n" + group + ":\n";
    for (const OptionSpec* spec : specs) text += help_entry(*spec, detail);
  });
  return text;
}

}  // namespace

std::string usage_text(const CommandHelp& command) {
  std::string text = "b3dgs " + command.name;
  for (const OptionSpec* spec : command.options) {
    if (!spec->positional) continue;
    std::string name = spec->name;
    std::transform(name.begin(), name.end(), name.begin(), [](unsigned char c) { return std::toupper(c); });
    text += " [" + name + "]";
  }
  return text + " [OPTIONS]";
}

std::string help_text(const CommandHelp& command) {
  const std::size_t n_options = command.options.size();
  const bool is_short_list = n_options <= kMaxShortHelp;
  const auto is_wanted = [&](const OptionSpec& spec) { return is_short_list || spec.is_common; };
  return list_options(command, is_wanted, HelpDetail::kShort) + "\nb3dgs " + command.name + " --help-all" +
         (is_short_list ? " adds ranges and aliases.\n" : " lists all " + std::to_string(n_options) + " options.\n");
}

std::string full_help_text(const CommandHelp& command) {
  const auto is_wanted = [](const OptionSpec&) { return true; };
  return list_options(command, is_wanted, HelpDetail::kAll) + (command.notes.empty() ? "" : "\n" + command.notes);
}

std::string markdown_help(const CommandHelp& command) {
  std::string text = "## b3dgs " + command.name + "\n\n" + wrap(command.summary, 100, 0) + "\n";
  if (!command.example.empty()) text += "\n    " + command.example + "\n";
  for_each_group(
      command, [](const OptionSpec&) { return true; },
      [&](const std::string& group, const std::vector<const OptionSpec*>& specs) {
        text += "\n### " + group + "\n\n| Option | Also | Default | Range | Meaning |\n|---|---|---|---|---|\n";
        for (const OptionSpec* spec : specs) text += markdown_row(*spec);
      });
  return text + "\n";
}

}  // namespace b3dgs
