#include "core/command_line.h"

#include <CLI/CLI.hpp>
#include <algorithm>
#include <charconv>
#include <fstream>
#include <iostream>
#include <iterator>
#include <sstream>

#include "core/json_text.h"

namespace b3dgs {
namespace {

constexpr std::size_t kNameColumn = 36;  // of the help text
constexpr std::size_t kTextColumns = 78;

/// "--some-name=x" -> "--some_name=x"; other words stay.
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

std::string wrap(const std::string& text, std::size_t columns) {
  std::istringstream words(text);
  std::string wrapped, word;
  std::size_t used = 0;
  while (words >> word) {
    if (used > 0 && used + 1 + word.size() > columns) {
      wrapped += '\n';
      used = 0;
    }
    if (used > 0) wrapped += ' ', ++used;
    wrapped += word;
    used += word.size();
  }
  return wrapped;
}

std::string default_text(const OptionSpec& spec) {
  const nlohmann::json& value = spec.default_value;
  if (value.is_boolean()) return value.get<bool>() ? "on" : "";
  if (value.is_string()) return value.get<std::string>();
  std::string text = value.dump();
  if (value.is_array()) {
    text = text.substr(1, text.size() - 2);
    std::replace(text.begin(), text.end(), ',', ' ');
    text.erase(std::remove(text.begin(), text.end(), '"'), text.end());
    if (text.empty()) text = "none";
  }
  return text;
}

/// "optimisation steps (default 30000; at least 1; also --max_steps)"
std::string description(const OptionSpec& spec) {
  std::vector<std::string> notes;
  if (const std::string text = default_text(spec); !text.empty()) notes.push_back("default " + text);
  if (!spec.range.empty()) notes.push_back(spec.range);
  std::string also;
  for (const char* other : spec.option.other) also += std::string(also.empty() ? "also --" : ", --") + other;
  if (!also.empty()) notes.push_back(also);
  std::string text = spec.help;
  for (std::size_t i = 0; i < notes.size(); ++i) text += (i == 0 ? " (" : "; ") + notes[i];
  return wrap(notes.empty() ? text : text + ")", kTextColumns);
}

/// Names in CLI11's notation: "scene,-s,--source_path,--data_dir".
std::string cli11_names(const OptionSpec& spec) {
  const std::string name(spec.option.name);
  std::string names = spec.positional ? name + "," : "";
  if (spec.option.letter != '\0') names += std::string("-") + spec.option.letter + ",";
  names += "--" + name;
  for (const char* other : spec.option.other) names += std::string(",--") + other;
  if (spec.kind == ValueKind::kFlag) names += ",!--no_" + name;
  return names;
}

template <class Number>
Number to_number(const OptionSpec& spec, const std::string& word) {
  Number value{};
  const char* end = word.data() + word.size();
  const auto [stop, error] = std::from_chars(word.data(), end, value);
  if (error == std::errc() && stop == end && std::isfinite(static_cast<double>(value))) return value;
  std::string wanted = "number";
  if constexpr (std::is_integral_v<Number>) {
    const bool is_too_large = error == std::errc::result_out_of_range && stop == end;
    wanted = "whole number" + (is_too_large ? detail::limits_text<Number>() : "");
  }
  input_error("command line: ", spec.option.name, " must be a ", wanted, ", found \"", word, "\"");
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
        input_error("command line: ", spec.option.name, " must be true or false, found \"", words.back(), "\"");
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
      return "N ...";
    case ValueKind::kNumbers:
      return "X ...";
    case ValueKind::kNames:
      return "NAME ...";
    case ValueKind::kText:
      return spec.range.empty() ? "TEXT" : "NAME";
  }
  return "";
}

/// CLI11's layout, with aliases left to the description.
class HelpFormatter : public CLI::Formatter {
 public:
  std::string make_option_name(const CLI::Option* option, bool is_positional) const override {
    if (is_positional) return option->get_name(true);
    const std::string letter = option->get_snames().empty() ? "    " : "-" + option->get_snames().front() + ", ";
    return letter + "--" + option->get_lnames().front();
  }
  std::string make_option_opts(const CLI::Option* option) const override {
    return option->get_type_name().empty() ? "" : " " + option->get_type_name();
  }
};

}  // namespace

struct CommandLine::Impl {
  struct Row {
    OptionSpec spec;
    CLI::Option* option;
  };
  CLI::App app;
  std::vector<Row> rows;

  std::vector<std::string> known_names() const {
    std::vector<std::string> names{"help"};
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

  /// Words as CLI11 takes them, last first: underscores in names, and "--flag false" joined to "--flag=false".
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
    if (word.empty() || word[0] != '-') input_error("command line: unexpected argument \"", word, "\"");
    const std::string option = word.substr(0, word.find('='));
    const std::string nearest = option.compare(0, 2, "--") == 0 ? nearest_name(option.substr(2), known_names()) : "";
    input_error("command line: unknown option ", option,
                nearest.empty() ? "; see b3dgs " + app.get_name() + " --help" : "; did you mean --" + nearest + "?");
  }
};

CommandLine::CommandLine(const std::string& name, const std::string& summary) : impl_(std::make_unique<Impl>()) {
  CLI::App& app = impl_->app;
  app.name(name);
  app.description(summary);
  app.allow_extras();  // reported by reject(), with the nearest name
  app.set_help_flag("-h,--help", "print this text");
  app.get_help_ptr()->group("Help");
  auto formatter = std::make_shared<HelpFormatter>();
  formatter->column_width(kNameColumn);
  app.formatter(formatter);
}

CommandLine::~CommandLine() = default;

void CommandLine::add(const OptionSpec& spec, const std::string& heading) {
  CLI::App& app = impl_->app;
  CLI::Option* option = spec.kind == ValueKind::kFlag ? app.add_flag(cli11_names(spec))
                                                      : app.add_option(cli11_names(spec), CLI::callback_t());
  option->description(description(spec));
  option->group(spec.unused ? "" : heading)->type_name(value_name(spec));
  if (is_list(spec)) {
    option->expected(0, CLI::detail::expected_max_vector_size)->allow_extra_args();
  } else {
    option->multi_option_policy(CLI::MultiOptionPolicy::TakeLast);
  }
  impl_->rows.push_back({spec, option});
}

bool CommandLine::parse(const std::vector<std::string>& words) {
  CLI::App& app = impl_->app;
  try {
    app.parse(impl_->prepared(words));
  } catch (const CLI::CallForHelp&) {
    std::cout << help();
    return false;
  } catch (const CLI::ParseError& error) {
    std::string reason = error.what();
    std::replace(reason.begin(), reason.end(), '\n', ' ');
    input_error("command line: ", reason);
  }
  if (const std::vector<std::string> extras = app.remaining(); !extras.empty()) {
    // An unknown option leaves its value behind, too: the option is what the user has to hear of.
    const auto option =
        std::find_if(extras.begin(), extras.end(), [](const std::string& word) { return word[0] == '-'; });
    impl_->reject(option == extras.end() ? extras.front() : *option);
  }
  for (const Impl::Row& row : impl_->rows) {
    if (row.option->count() == 0) continue;
    std::vector<std::string> results = row.option->results();
    // CLI11 stands an empty word, or "{}", for a list without values.
    if (is_list(row.spec) && results.size() == 1 && (results[0].empty() || results[0] == "{}")) {
      results.clear();
    }
    given_[std::string(row.spec.option.name)] = to_json(row.spec, results);
  }
  return true;
}

std::string CommandLine::help() const {
  return impl_->app.help("b3dgs");
}

nlohmann::ordered_json read_json_file(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file) input_error(path, ": cannot be opened; --config needs a JSON file with option names as keys");
  const std::string text{std::istreambuf_iterator<char>(file), {}};
  nlohmann::ordered_json json = parse_json(text, /*ignore_comments=*/true);
  if (!json.is_discarded()) return json;
  try {
    json = nlohmann::ordered_json::parse(text, nullptr, true, /*ignore_comments=*/true);  // for its reason
  } catch (const nlohmann::json::exception& error) {
    std::string reason = error.what();
    std::replace(reason.begin(), reason.end(), '\n', ' ');
    input_error(path, ": no valid JSON: ", reason);
  }
  input_error(path, ": is nested deeper than ", kMaxJsonDepth, " levels, expected option names and values");
}

std::string nearest_name(const std::string& name, const std::vector<std::string>& known) {
  if (name.empty()) return "";
  std::string best;
  std::size_t best_distance = std::max<std::size_t>(2, name.size() / 3) + 1;
  for (const std::string& candidate : known) {
    // An abbreviation counts as near, however much is missing.
    const bool is_start = name.size() >= 3 && candidate.compare(0, name.size(), name) == 0;
    // So does a word put behind: tile_width for tile.
    const bool is_longer = name.compare(0, candidate.size() + 1, candidate + "_") == 0;
    const std::size_t distance = is_start || is_longer ? 1 : edit_distance(name, candidate);
    if (distance < best_distance) {
      best = candidate;
      best_distance = distance;
    }
  }
  return best;
}

}  // namespace b3dgs
