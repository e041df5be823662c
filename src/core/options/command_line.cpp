#include "core/options/command_line.h"

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cctype>
#include <iostream>
#include <set>
#include <utility>

#include "core/options/help_pages.h"
#include "core/options/nearest_name.h"
#include "core/options/option_values.h"

namespace b3dgs {
namespace {

/// "--some-name=x" -> "--some_name=x"; other words are unchanged.
std::string with_underscores(std::string word) {
  if (word.size() < 3 || word.compare(0, 2, "--") != 0) return word;
  const std::size_t end = std::min(word.find('='), word.size());
  std::replace(word.begin() + 2, word.begin() + static_cast<std::ptrdiff_t>(end), '-', '_');
  return word;
}

/// "-m" or "--seeds", but not "-1".
bool is_option(const std::string& word) {
  return word.size() > 1 && word[0] == '-' &&
         (word[1] == '-' || std::isalpha(static_cast<unsigned char>(word[1])) != 0);
}

/// "0,1,2", but not "0,": a list with commas is one word, unless the word ends in one.
bool is_whole_list(const std::string& word) {
  const std::size_t comma = word.find(',');
  return comma != std::string::npos && word.back() != ',';
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

  CommandHelp help() const {
    CommandHelp command{app.get_name(), summary, example, notes, {}};
    for (const Row& row : rows) {
      if (!row.spec.is_ignored) command.options.push_back(&row.spec);
    }
    return command;
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

  /// The option that needs the next word as its value, or null.
  const Row* option_with_value(const std::string& word) const {
    const bool is_letter = word.size() == 2 && word[0] == '-';
    const Row* row = word.compare(0, 2, "--") == 0 ? find(word.substr(2)) : nullptr;
    for (const Row& own : rows) {
      if (is_letter && own.spec.letter == word[1]) row = &own;
    }
    return row == nullptr || row->spec.kind == ValueKind::kFlag || is_list(row->spec) ? nullptr : row;
  }

  /// As from `-m $OUT --eval`, where the variable OUT is not set. A choice may begin with "-": `--up -y`.
  void require_value(const Row& row, const std::string& value) const {
    if (row.spec.lists_choices || !is_option(value)) return;
    input_error("missing value: --", row.spec.name, " is followed by ", value,
                row.spec.kind == ValueKind::kText
                    ? " (a shell variable that is not set?); for a name that begins with \"-\", write --" +
                          row.spec.name + "=" + value + " or ./" + value
                    : " (expected a number)");
  }

  /// The words as CLI11 expects them, last first: underscores in names, "--flag false" joined to "--flag=false", and
  /// "--" at the end of a list with commas, so that "--seeds 0,1 scene" leaves the scene for the positional argument.
  /// Of a list that is given twice, only the last one is left, since the last value of any option counts.
  std::vector<std::string> prepared(const std::vector<std::string>& words) const {
    struct Part {
      const Row* list;  // the list option that the part begins with, or null
      std::vector<std::string> words;
    };
    std::vector<Part> parts{{nullptr, {}}};
    for (std::size_t i = 0; i < words.size(); ++i) {
      std::string word = with_underscores(words[i]);
      const std::size_t equals = word.find('=');
      const Row* row = word.compare(0, 2, "--") == 0 ? find(word.substr(2, equals - 2)) : nullptr;
      if (is_option(word)) parts.push_back({row != nullptr && is_list(row->spec) ? row : nullptr, {}});
      if (const Row* const own = option_with_value(word); own != nullptr && i + 1 < words.size()) {
        require_value(*own, words[i + 1]);
        parts.back().words.push_back(std::move(word));
        parts.back().words.push_back(words[++i]);
        continue;
      }
      if (equals == std::string::npos && row != nullptr && row->spec.kind == ValueKind::kFlag && i + 1 < words.size() &&
          is_truth_value(words[i + 1])) {
        word += "=" + words[++i];
      }
      const bool ends_list = parts.back().list != nullptr && is_whole_list(word);
      const bool has_empty_value = row != nullptr && !is_list(row->spec) && equals + 1 == word.size();
      if (has_empty_value && row->spec.kind == ValueKind::kFlag) option_value(row->spec, {""});  // throws
      if (has_empty_value) word.pop_back();  // CLI11 would take the next word as the value of "--name="
      parts.back().words.push_back(std::move(word));
      if (has_empty_value) parts.back().words.emplace_back();
      if (!ends_list) continue;
      parts.back().words.emplace_back("--");
      parts.push_back({nullptr, {}});
    }
    std::vector<std::string> result;
    std::set<const Row*> given;
    for (auto part = parts.rbegin(); part != parts.rend(); ++part) {
      if (part->list != nullptr && !given.insert(part->list).second) continue;
      result.insert(result.end(), part->words.rbegin(), part->words.rend());
    }
    return result;
  }

  [[noreturn]] void reject(const std::string& word) const {
    if (word.empty() || word[0] != '-') {
      input_error("unexpected argument \"", word, "\"; usage: ", usage_text(help()), "; see ", command("--help"));
    }
    const std::string option = word.substr(0, word.find('='));
    const bool is_long = option.compare(0, 2, "--") == 0;
    std::string nearest = name_of_other_trainers(option.substr(is_long ? 2 : 1), known_names());
    if (nearest.empty() && is_long) nearest = nearest_name(option.substr(2), known_names());
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
    given_[std::string(row.spec.name)] = option_value(row.spec, results);
  }
  return true;
}

std::string CommandLine::help() const {
  return help_text(impl_->help());
}

std::string CommandLine::help_all() const {
  return full_help_text(impl_->help());
}

std::string CommandLine::help_markdown() const {
  return markdown_help(impl_->help());
}

}  // namespace b3dgs
