#include "core/command_line.h"

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cctype>
#include <charconv>
#include <fstream>
#include <iostream>
#include <iterator>
#include <sstream>
#include <utility>

#include "core/json_text.h"

namespace b3dgs {
namespace {

// Columns of the help text.
constexpr std::size_t kNameColumns = 36;
constexpr std::size_t kTextColumns = 84;

/// "--some-name=x" -> "--some_name=x"; other words are unchanged.
std::string with_underscores(std::string word) {
  if (word.size() < 3 || word.compare(0, 2, "--") != 0) return word;
  const std::size_t end = std::min(word.find('='), word.size());
  std::replace(word.begin() + 2, word.begin() + static_cast<std::ptrdiff_t>(end), '-', '_');
  return word;
}

bool is_list(const OptionSpec& spec) {
  return spec.kind == ValueKind::kInts || spec.kind == ValueKind::kInt64s || spec.kind == ValueKind::kNumbers ||
         spec.kind == ValueKind::kNames;
}

bool is_truth_value(const std::string& word) {
  return word == "true" || word == "false";
}

std::size_t edit_distance(const std::string& a, const std::string& b) {
  std::vector<std::size_t> row(b.size() + 1);
  for (std::size_t j = 0; j <= b.size(); ++j) row[j] = j;
  for (std::size_t i = 1; i <= a.size(); ++i) {
    std::size_t diagonal = row[0];
    row[0] = i;
    for (std::size_t j = 1; j <= b.size(); ++j) {
      const std::size_t substituted = diagonal + (a[i - 1] != b[j - 1]);
      diagonal = row[j];
      row[j] = std::min({substituted, row[j] + 1, row[j - 1] + 1});
    }
  }
  return row[b.size()];
}

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

/// Names in CLI11's notation: "scene,-s,--source_path,--data_dir".
std::string cli11_names(const OptionSpec& spec) {
  std::string names = spec.positional ? spec.name + "," : "";
  if (spec.letter != '\0') names += std::string("-") + spec.letter + ",";
  names += "--" + spec.name;
  for (const std::string& alias : spec.aliases) names += ",--" + alias;
  if (spec.kind == ValueKind::kFlag) names += ",!--no_" + spec.name;
  return names;
}

template <class Number>
Number to_number(const OptionSpec& spec, const std::string& word) {
  Number value{};
  const char* end = word.data() + word.size();
  const auto [stop, error] = std::from_chars(word.data(), end, value);
  if (error == std::errc() && stop == end && std::isfinite(static_cast<double>(value))) return value;
  std::string expected = "a number";
  if constexpr (std::is_integral_v<Number>) {
    const bool is_too_large = error == std::errc::result_out_of_range && stop == end;
    expected = "a whole number" + (is_too_large ? detail::limits_text<Number>() : "");
  }
  detail::invalid_value(/*place=*/"", spec.name, expected, '"' + word + '"');
}

template <class Number>
nlohmann::json to_numbers(const OptionSpec& spec, const std::vector<std::string>& words) {
  nlohmann::json values = nlohmann::json::array();
  for (const std::string& word : words) values.push_back(to_number<Number>(spec, word));
  return values;
}

/// "a,b" "c" -> a b c
std::vector<std::string> split_at_commas(const std::vector<std::string>& words) {
  std::vector<std::string> parts;
  for (const std::string& word : words) {
    std::istringstream text(word);
    for (std::string part; std::getline(text, part, ',');) parts.push_back(part);
  }
  return parts;
}

nlohmann::json to_json(const OptionSpec& spec, const std::vector<std::string>& words) {
  switch (spec.kind) {
    case ValueKind::kFlag:
      if (!is_truth_value(words.back())) {
        detail::invalid_value(/*place=*/"", spec.name, "true or false", '"' + words.back() + '"');
      }
      return words.back() == "true";
    case ValueKind::kInt:
      return to_number<int>(spec, words.back());
    case ValueKind::kInt64:
      return to_number<std::int64_t>(spec, words.back());
    case ValueKind::kNumber:
      return to_number<double>(spec, words.back());
    case ValueKind::kText:
      return words.back();
    case ValueKind::kInts:
      return to_numbers<int>(spec, words);
    case ValueKind::kInt64s:
      return to_numbers<std::int64_t>(spec, words);
    case ValueKind::kNumbers:
      return to_numbers<double>(spec, words);
    case ValueKind::kNames:
      return split_at_commas(words);
  }
  return {};
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

}  // namespace

struct CommandLine::Impl {
  struct Row {
    OptionSpec spec;
    CLI::Option* option;
  };
  CLI::App app;
  CLI::Option* markdown_flag = nullptr;
  std::string summary, example, notes;
  std::vector<Row> rows;

  /// "b3dgs train --help-all"
  std::string command(const std::string& words) const { return "b3dgs " + app.get_name() + " " + words; }

  std::size_t count_listed() const {
    return static_cast<std::size_t>(
        std::count_if(rows.begin(), rows.end(), [](const Row& row) { return !row.spec.is_ignored; }));
  }

  /// Calls `visit(group, specs)` for each group of listed options, in the order in which the groups begin.
  template <class Wanted, class Visit>
  void for_each_group(Wanted&& is_wanted, Visit&& visit) const {
    std::vector<std::pair<std::string, std::vector<const OptionSpec*>>> groups;
    for (const Row& row : rows) {
      if (row.spec.is_ignored || !is_wanted(row.spec)) continue;
      const auto same = [&](const auto& group) { return group.first == row.spec.group; };
      auto group = std::find_if(groups.begin(), groups.end(), same);
      if (group == groups.end()) group = groups.insert(groups.end(), {row.spec.group, {}});
      group->second.push_back(&row.spec);
    }
    for (const auto& [group, specs] : groups) visit(group, specs);
  }

  /// Summary, usage and example.
  std::string introduction() const {
    std::string text = wrap(summary, kNameColumns + kTextColumns, 0) + "\n\nUsage: b3dgs " + app.get_name();
    for (const Row& row : rows) {
      if (!row.spec.positional) continue;
      std::string name = row.spec.name;
      std::transform(name.begin(), name.end(), name.begin(), [](unsigned char c) { return std::toupper(c); });
      text += " [" + name + "]";
    }
    text += " [OPTIONS]\n";
    return example.empty() ? text : text + "Example: " + example + "\n";
  }

  template <class Wanted>
  std::string help(Wanted&& is_wanted, HelpDetail detail) const {
    std::string text = introduction();
    for_each_group(is_wanted, [&](const std::string& group, const std::vector<const OptionSpec*>& specs) {
      text += "\n" + group + ":\n";
      for (const OptionSpec* spec : specs) text += help_entry(*spec, detail);
    });
    return text;
  }

  std::vector<std::string> known_names() const {
    std::vector<std::string> names{"help", "help_all"};
    for (const Row& row : rows) {
      for (const std::string& name : row.option->get_lnames()) names.push_back(name);
    }
    return names;
  }

  const Row* find(const std::string& long_name) const {
    for (const Row& row : rows) {
      if (row.option->check_lname(long_name)) return &row;
    }
    return nullptr;
  }

  /// The words as CLI11 expects them, last first: underscores in names, and "--flag false" joined to "--flag=false".
  std::vector<std::string> prepared(const std::vector<std::string>& words) const {
    std::vector<std::string> result;
    for (std::size_t i = 0; i < words.size(); ++i) {
      std::string word = with_underscores(words[i]);
      const Row* row = word.compare(0, 2, "--") == 0 ? find(word.substr(2)) : nullptr;
      if (row != nullptr && row->spec.kind == ValueKind::kFlag && i + 1 < words.size() &&
          is_truth_value(words[i + 1])) {
        word += "=" + words[++i];
      }
      result.push_back(std::move(word));
    }
    std::reverse(result.begin(), result.end());
    return result;
  }

  [[noreturn]] void reject(const std::string& word) const {
    if (word.empty() || word[0] != '-') input_error("unexpected argument \"", word, "\"; see ", command("--help"));
    const std::string option = word.substr(0, word.find('='));
    const std::string nearest = option.compare(0, 2, "--") == 0 ? nearest_name(option.substr(2), known_names()) : "";
    input_error("unknown option ", option,
                nearest.empty() ? "; see " + command("--help-all") : "; did you mean --" + nearest + "?");
  }
};

CommandLine::CommandLine(const std::string& name, const std::string& summary, const std::string& example)
    : impl_(std::make_unique<Impl>()) {
  CLI::App& app = impl_->app;
  app.name(name);
  impl_->summary = summary;
  impl_->example = example;
  app.allow_extras();  // reported by reject(), with the nearest name
  app.set_help_flag("-h,--help");
  app.set_help_all_flag("--help_all");
  impl_->markdown_flag = app.add_flag("--help_markdown");
}

CommandLine::~CommandLine() = default;

void CommandLine::add(const OptionSpec& spec) {
  CLI::App& app = impl_->app;
  CLI::Option* option = spec.kind == ValueKind::kFlag ? app.add_flag(cli11_names(spec))
                                                      : app.add_option(cli11_names(spec), CLI::callback_t());
  if (is_list(spec)) {
    option->expected(0, CLI::detail::expected_max_vector_size)->allow_extra_args();
  } else {
    option->multi_option_policy(CLI::MultiOptionPolicy::TakeLast);
  }
  impl_->rows.push_back({spec, option});
}

void CommandLine::set_help(const std::string& name, const std::string& help) {
  for (Impl::Row& row : impl_->rows) {
    if (row.spec.name != name) continue;
    row.spec.help = help;
    return;
  }
  B3DGS_CHECK(false, "no option --", name);
}

void CommandLine::set_notes(const std::string& notes) {
  impl_->notes = notes;
}

bool CommandLine::parse(const std::vector<std::string>& words) {
  CLI::App& app = impl_->app;
  try {
    app.parse(impl_->prepared(words));
  } catch (const CLI::CallForHelp&) {
    std::cout << help();
    return false;
  } catch (const CLI::CallForAllHelp&) {
    std::cout << help_all();
    return false;
  } catch (const CLI::ArgumentMismatch& error) {
    const std::string text = error.what();  // "--name: 1 required ... missing"
    input_error("missing value: ", text.substr(0, text.find(':')));
  } catch (const CLI::ParseError& error) {
    std::string reason = error.what();
    std::replace(reason.begin(), reason.end(), '\n', ' ');
    input_error("invalid command line: ", reason);
  }
  if (impl_->markdown_flag->count() > 0) {
    std::cout << help_markdown();
    return false;
  }
  if (const std::vector<std::string> extras = app.remaining(); !extras.empty()) {
    // The value of an unknown option is left over, too; the message is about the option.
    const auto option =
        std::find_if(extras.begin(), extras.end(), [](const std::string& word) { return word[0] == '-'; });
    impl_->reject(option == extras.end() ? extras.front() : *option);
  }
  for (const Impl::Row& row : impl_->rows) {
    if (row.option->count() == 0) continue;
    std::vector<std::string> results = row.option->results();
    // CLI11 represents a list without values by an empty word or by "{}".
    if (is_list(row.spec) && results.size() == 1 && (results[0].empty() || results[0] == "{}")) {
      results.clear();
    }
    given_[std::string(row.spec.name)] = to_json(row.spec, results);
  }
  return true;
}

std::string CommandLine::help() const {
  const std::size_t n_listed = impl_->count_listed();
  const bool is_short_list = n_listed <= kMaxShortHelp;
  std::string text =
      impl_->help([&](const OptionSpec& spec) { return is_short_list || spec.is_common; }, HelpDetail::kShort);
  return text + "\n" + impl_->command("--help-all") +
         (is_short_list ? " adds ranges and aliases.\n" : " lists all " + std::to_string(n_listed) + " options.\n");
}

std::string CommandLine::help_all() const {
  return impl_->help([](const OptionSpec&) { return true; }, HelpDetail::kAll) +
         (impl_->notes.empty() ? "" : "\n" + impl_->notes);
}

std::string CommandLine::help_markdown() const {
  std::string text = "## b3dgs " + impl_->app.get_name() + "\n\n" + wrap(impl_->summary, 100, 0) + "\n";
  if (!impl_->example.empty()) text += "\n    " + impl_->example + "\n";
  impl_->for_each_group([](const OptionSpec&) { return true; },
                        [&](const std::string& group, const std::vector<const OptionSpec*>& specs) {
                          text += "\n### " + group +
                                  "\n\n| Option | Also | Default | Range | Meaning |\n|---|---|---|---|---|\n";
                          for (const OptionSpec* spec : specs) text += markdown_row(*spec);
                        });
  return text + "\n";
}

nlohmann::ordered_json read_json_file(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file) input_error("cannot open config file: ", path, " (expected a JSON file with option names as keys)");
  const std::string text{std::istreambuf_iterator<char>(file), {}};
  nlohmann::ordered_json json = parse_json(text, /*ignore_comments=*/true);
  if (!json.is_discarded()) return json;
  try {
    json = nlohmann::ordered_json::parse(text, nullptr, true, /*ignore_comments=*/true);  // for its error message
  } catch (const nlohmann::json::exception& error) {
    std::string reason = error.what();
    std::replace(reason.begin(), reason.end(), '\n', ' ');
    input_error("not valid JSON: ", path, " (", reason, ")");
  }
  input_error("JSON nested too deeply: ", path, " (at most ", kMaxJsonDepth, " levels)");
}

std::string nearest_name(const std::string& name, const std::vector<std::string>& known) {
  if (name.empty()) return "";
  std::string best;
  std::size_t best_distance = std::max<std::size_t>(2, name.size() / 3) + 1;
  for (const std::string& candidate : known) {
    // An abbreviation counts as similar, however short.
    const bool is_abbreviation = name.size() >= 3 && candidate.compare(0, name.size(), name) == 0;
    // So does a name with more words: tile_width for tile.
    const bool is_longer = name.compare(0, candidate.size() + 1, candidate + "_") == 0;
    const std::size_t distance = is_abbreviation || is_longer ? 1 : edit_distance(name, candidate);
    if (distance < best_distance) {
      best = candidate;
      best_distance = distance;
    }
  }
  return best;
}

}  // namespace b3dgs
