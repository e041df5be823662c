// Help texts of a subcommand, and its section of docs/options.md.
#include <algorithm>
#include <cctype>
#include <sstream>
#include <utility>

#include "core/options/command_line.h"
#include "core/text.h"

namespace b3dgs {
namespace {

// Columns of the help text.
constexpr std::size_t kNameColumns = 36;
constexpr std::size_t kTextColumns = 84;

/// Breaks the text at blanks into lines of at most `columns`. All lines but the first are indented by `indent`.
std::string wrap(const std::string& text, std::size_t columns, std::size_t indent) {
  std::istringstream words(text);
  std::string wrapped;
  std::size_t used = 0;
  for (std::string word; words >> word; wrapped += word) {
    const bool fits = used + 1 + word.size() <= columns;
    if (!wrapped.empty()) wrapped += fits ? " " : "\n" + std::string(indent, ' ');
    used = (wrapped.empty() || !fits ? 0 : used + 1) + word.size();
  }
  return wrapped;
}

/// Returns "--a, --b", or in Markdown "`--a`, `--b`".
std::string alias_list(const OptionSpec& spec, const std::string& quote = "") {
  std::vector<std::string> names;
  for (const std::string& name : spec.aliases) names.push_back(quote + "--" + name + quote);
  return list_text(names);
}

/// Returns the default value, empty for an empty text and for a flag that is off.
std::string default_text(const OptionSpec& spec) {
  return spec.default_value == false || spec.default_value == "" ? "" : option_value_text(spec.default_value);
}

/// Returns "training iterations (default 30000; at least 1; also --max_steps)", with ranges and aliases only if `all`.
std::string description(const OptionSpec& spec, bool all) {
  std::vector<std::string> notes;
  if (const std::string text = default_text(spec); !text.empty()) notes.push_back("default " + text);
  if (spec.default_value == true) notes.push_back("--no_" + spec.name + " turns it off");
  if (!spec.range.empty() && (all || spec.lists_choices)) notes.push_back(spec.range);
  if (all && !spec.aliases.empty()) notes.push_back("also " + alias_list(spec));
  if (notes.empty()) return spec.help;
  // A note at the end of the help text, such as "(0 = never)", and these notes share one pair of parentheses.
  const bool has_note = !spec.help.empty() && spec.help.back() == ')' && spec.help.find(" (") != std::string::npos;
  return (has_note ? spec.help.substr(0, spec.help.size() - 1) + "; " : spec.help + " (") + list_text(notes, "; ") +
         ")";
}

std::string value_name(const OptionSpec& spec) {
  constexpr const char* kNames[] = {"", "N", "N", "X", "TEXT"};
  const bool is_name = spec.kind == OptionSpec::Kind::kText && (spec.is_list || !spec.range.empty());
  return std::string(is_name ? "NAME" : kNames[static_cast<std::size_t>(spec.kind)]) + (spec.is_list ? "..." : "");
}

/// Returns one option of a help text: "  -s, --source_path TEXT  ...". The description starts at a fixed column.
std::string help_entry(const OptionSpec& spec, bool all) {
  std::string names = spec.letter == '\0' ? "      " : std::string("  -") + spec.letter + ", ";
  names += "--" + spec.name + (spec.is_flag() ? "" : " ") + value_name(spec);
  if (names.size() + 2 > kNameColumns) names += "\n" + std::string(kNameColumns, ' ');
  names.resize(std::max(names.size(), kNameColumns), ' ');
  return names + wrap(description(spec, all), kTextColumns, kNameColumns) + "\n";
}

/// A cell of a Markdown table.
std::string cell(std::string text) {
  for (std::size_t at = 0; (at = text.find('|', at)) != std::string::npos; at += 2) text.insert(at, 1, '\\');
  return " " + text + " |";
}

std::string markdown_row(const OptionSpec& spec) {
  std::string names = spec.letter == '\0' ? "" : std::string("`-") + spec.letter + "`";
  if (!spec.aliases.empty()) names += (names.empty() ? "" : ", ") + alias_list(spec, "`");
  const std::string value = default_text(spec);
  return "|" + cell("`--" + spec.name + "`") + cell(names) + cell(spec.is_flag() && value.empty() ? "off" : value) +
         cell(spec.is_flag() ? "flag" : spec.range) + cell(spec.help) + "\n";
}

std::string list_options(const std::vector<const OptionSpec*>& options, bool all) {
  std::string text, group;
  for (const OptionSpec* spec : options) {
    if (spec->group != group) text += "\n" + spec->group + ":\n";
    group = spec->group;
    text += help_entry(*spec, all);
  }
  return text;
}

}  // namespace

std::string option_value_text(const nlohmann::ordered_json& value) {
  if (value.is_boolean()) return value.get<bool>() ? "on" : "off";
  if (value.is_string()) return value.get<std::string>().empty() ? "none" : value.get<std::string>();
  if (value.is_number_float()) return print_to_string("%g", value.get<double>());
  if (!value.is_array()) return value.dump();
  std::string text;
  for (const auto& entry : value) text += (text.empty() ? "" : " ") + option_value_text(entry);
  return text.empty() ? "none" : text;
}

std::vector<const OptionSpec*> CommandLine::listed(bool only_common) const {
  std::vector<const OptionSpec*> options;
  for (const OptionSpec& spec : options_) {
    if (spec.is_ignored || (only_common && !spec.is_common)) continue;
    const auto is_same_group = [&](const OptionSpec* other) { return other->group == spec.group; };
    const auto last = std::find_if(options.rbegin(), options.rend(), is_same_group);
    options.insert(last == options.rend() ? options.end() : last.base(), &spec);
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
  const std::size_t n_all = listed().size();
  const bool is_short_list = n_all <= kMaxShortHelp;
  return introduction() + list_options(listed(/*only_common=*/!is_short_list), /*all=*/false) + "\nb3dgs " + name_ +
         " --help-all" +
         (is_short_list ? " adds ranges and aliases.\n" : " lists all " + std::to_string(n_all) + " options.\n");
}

std::string CommandLine::help_all() const {
  return introduction() + list_options(listed(), /*all=*/true) + (notes_.empty() ? "" : "\n" + notes_);
}

std::string CommandLine::help_markdown() const {
  std::string text = "## b3dgs " + name_ + "\n\n" + wrap(summary_, 100, 0) + "\n";
  if (!example_.empty()) text += "\n    " + example_ + "\n";
  std::string group;
  for (const OptionSpec* spec : listed()) {
    if (spec->group != group) {
      text += "\n### " + spec->group + "\n\n| Option | Also | Default | Range | Meaning |\n|---|---|---|---|---|\n";
    }
    group = spec->group;
    text += markdown_row(*spec);
  }
  return text + "\n";
}

}  // namespace b3dgs
