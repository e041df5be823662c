#include "core/options/command_line.h"

#include <algorithm>
#include <cctype>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <iostream>
#include <map>
#include <numeric>
#include <optional>
#include <sstream>

#include "core/files/file_reader.h"
#include "core/json_text.h"

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

bool is_truth_value(const std::string& word) {
  return word == "true" || word == "false";
}

/// Refuses an option as a value, as from `-m $OUT --eval` if OUT is not set. A choice may begin with "-": `--up -y`.
void require_value(const OptionSpec& spec, const std::string& value) {
  if (spec.lists_choices || !is_option(value)) return;
  input_error("missing value: --", spec.name, " is followed by ", value,
              spec.kind == OptionSpec::Kind::kText
                  ? " (a shell variable that is not set?); for a name that begins with \"-\", write --" + spec.name +
                        "=" + value + " or ./" + value
                  : " (expected a number)");
}

/// "a,b" "c d" "e, f" -> a b c d e f. An empty entry is kept, so that it is reported.
std::vector<std::string> list_entries(const std::vector<std::string>& words) {
  std::vector<std::string> entries;
  for (const std::string& word : words) {
    std::istringstream text(word);
    for (std::string part; std::getline(text, part, ',');) {
      std::istringstream blanks(part);
      const std::size_t n_before = entries.size();
      for (std::string entry; blanks >> entry;) entries.push_back(entry);
      if (entries.size() == n_before) entries.emplace_back();
    }
  }
  return entries;
}

/// The meaning of a word of the command line.
struct Named {
  const OptionSpec* spec = nullptr;
  bool is_letter = false;            // -s
  bool is_negated = false;           // --no_eval
  std::optional<std::string> value;  // --name=value, -r2
};

Named find_option(const std::vector<OptionSpec>& options, const std::string& word) {
  Named found;
  found.is_letter = word[1] != '-';
  const std::size_t end = found.is_letter ? 2 : std::min(word.find('='), word.size());
  if (end < word.size()) found.value = word.substr(found.is_letter ? end : end + 1);
  const std::string name = word.substr(2, end - 2);
  for (const OptionSpec& spec : options) {
    found.is_negated = !found.is_letter && spec.is_flag() && name == "no_" + spec.name;
    found.spec = &spec;
    if (found.is_letter ? spec.letter == word[1] : found.is_negated || spec.has_name(name)) return found;
  }
  found.spec = nullptr;
  return found;
}

template <class Number>
nlohmann::json parse_number(const OptionSpec& spec, const std::string& word) {
  Number value{};
  const char* const end = word.data() + word.size();
  const auto [stop, error] = std::from_chars(word.data(), end, value);
  if (error == std::errc() && stop == end && std::isfinite(static_cast<double>(value))) return value;
  const bool is_too_large = error == std::errc::result_out_of_range && stop == end;
  const std::string whole = "a whole number" + (is_too_large ? detail::limits_text<Number>() : "");
  detail::invalid_value("", spec.name, std::is_integral_v<Number> ? whole : "a number", '"' + word + '"');
}

nlohmann::json parse_word(const OptionSpec& spec, const std::string& word) {
  if (spec.kind == OptionSpec::Kind::kInt) return parse_number<int>(spec, word);
  if (spec.kind == OptionSpec::Kind::kInt64) return parse_number<std::int64_t>(spec, word);
  if (spec.kind == OptionSpec::Kind::kNumber) return parse_number<double>(spec, word);
  if (spec.is_flag()) {
    if (!is_truth_value(word)) detail::invalid_value("", spec.name, "true or false", '"' + word + '"');
    return word == "true";
  }
  if (word.empty() && !spec.is_list && !spec.is_empty_allowed && !spec.lists_choices) {
    input_error("invalid value for --", spec.name,
                " (expected a text that is not empty, found \"\"); leave the option out to have none");
  }
  return word;
}

nlohmann::json parse_words(const OptionSpec& spec, const std::vector<std::string>& words) {
  if (!spec.is_list) return parse_word(spec, words.empty() ? "" : words.back());
  nlohmann::json values = nlohmann::json::array();
  for (const std::string& entry : list_entries(words)) values.push_back(parse_word(spec, entry));
  return values;
}

/// Returns the value of the option in words[i]. Moves i to the last word that belongs to it.
nlohmann::json take_value(const Named& named, std::vector<std::string>& words, std::size_t& i) {
  const OptionSpec& spec = *named.spec;
  std::vector<std::string> own;
  if (named.value) own.push_back(*named.value);
  const auto has_next = [&] { return i + 1 < words.size(); };
  if (spec.is_flag()) {
    if (named.is_letter && named.value) {  // several letters in one word, so the others are read next
      own = {"true"};
      words[i--] = "-" + *named.value;
    } else if (own.empty()) {
      own.push_back(has_next() && is_truth_value(words[i + 1]) ? words[++i] : "true");
    }
    return parse_words(spec, own) != named.is_negated;
  }
  if (spec.is_list) {  // "0,1,2" is a whole list, but not "0,"; the last value of an option counts, also of a list
    const auto is_whole = [](const std::string& text) {
      return text.find(',') != std::string::npos && text.back() != ',';
    };
    while (has_next() && !is_option(words[i + 1]) && (own.empty() || !is_whole(own.back()))) own.push_back(words[++i]);
  } else if (own.empty()) {
    if (!has_next()) input_error("missing value: --", spec.name);
    require_value(spec, words[i + 1]);
    own.push_back(words[++i]);
  }
  return parse_words(spec, own);
}

std::size_t edit_distance(const std::string& a, const std::string& b) {
  std::vector<std::size_t> row(b.size() + 1);
  std::iota(row.begin(), row.end(), std::size_t{0});
  for (std::size_t i = 1; i <= a.size(); ++i) {
    std::size_t diagonal = row[0];
    row[0] = i;
    for (std::size_t j = 1; j <= b.size(); ++j) {
      const std::size_t substituted = std::exchange(diagonal, row[j]) + (a[i - 1] != b[j - 1]);
      row[j] = std::min({substituted, row[j] + 1, row[j - 1] + 1});
    }
  }
  return row[b.size()];
}

}  // namespace

void CommandLine::set_help(const std::string& name, const std::string& help) {
  const auto spec =
      std::find_if(options_.begin(), options_.end(), [&](const OptionSpec& own) { return own.name == name; });
  B3DGS_CHECK(spec != options_.end(), "no option --", name);
  spec->help = help;
}

bool CommandLine::prints_help(const std::vector<std::string>& words) const {
  for (const std::string& given : words) {
    const std::string word = with_underscores(given);
    if (word == "--") break;
    if (word == "-h" || word == "--help") return std::cout << help(), true;
    if (word == "--help_all") return std::cout << help_all(), true;
    if (word == "--help_markdown") return std::cout << help_markdown(), true;
  }
  return false;
}

bool CommandLine::parse(std::vector<std::string> words) {
  if (prints_help(words)) return false;
  std::map<const OptionSpec*, nlohmann::json> values;  // in the order of options_
  std::string unknown, unexpected;                     // the first of each
  bool only_arguments = false;
  for (std::size_t i = 0; i < words.size(); ++i) {
    const std::string word = with_underscores(words[i]);
    if (!only_arguments && word == "--") {
      only_arguments = true;
    } else if (only_arguments || word.size() < 2 || word[0] != '-') {
      const auto place = std::find_if(options_.begin(), options_.end(), [&](const OptionSpec& spec) {
        return spec.positional && values.count(&spec) == 0;
      });
      if (place != options_.end()) {
        values[&*place] = parse_words(*place, {words[i]});
      } else if (unexpected.empty()) {
        unexpected = "\"" + words[i] + "\"";
      }
    } else if (const Named named = find_option(options_, word); named.spec == nullptr) {
      if (unknown.empty()) unknown = word;
    } else {
      values[named.spec] = take_value(named, words, i);
    }
  }
  // The value of an unknown option is also unexpected, but the message is about the option.
  if (!unknown.empty() || !unexpected.empty()) reject(unknown.empty() ? unexpected : unknown);
  for (const auto& [spec, value] : values) given_[spec->name] = value;
  for (const auto& set : setters_) set();
  return true;
}

void CommandLine::reject(const std::string& word) const {
  // Options, and names for them that other trainers use and that are not accepted here.
  static const std::pair<const char*, std::vector<std::string>> kNamesOfOtherTrainers[] = {
      {"iterations", {"total_steps", "num_steps", "max_num_iterations", "num_iterations"}},
      {"model_path", {"output", "output_dir", "output_path", "export_path", "o"}},
      {"output", {"output_dir", "output_path", "o"}},
      {"folder", {"output"}},
      {"white_background", {"background"}},
      {"source_path", {"data", "data_path"}},
  };
  if (word[0] != '-') {
    const bool has_arguments = usage() != "b3dgs " + name_ + " [OPTIONS]";
    input_error("unexpected argument ", word, "; usage: ", usage(),
                has_arguments ? "; for several, run it once for each" : "", "; see b3dgs ", name_, " --help");
  }
  std::vector<std::string> names{"help", "help_all"};
  for (const OptionSpec& spec : options_) {
    names.push_back(spec.name);
    names.insert(names.end(), spec.aliases.begin(), spec.aliases.end());
    if (spec.is_flag()) names.push_back("no_" + spec.name);
  }
  const std::string option = word.substr(0, word.find('='));
  const bool is_long = option.compare(0, 2, "--") == 0;
  const std::string name = option.substr(is_long ? 2 : 1);
  std::string nearest;
  for (const auto& [own, others] : kNamesOfOtherTrainers) {
    if (nearest.empty() && detail::is_among(name, others) && detail::is_among(own, names)) nearest = own;
  }
  if (nearest.empty() && is_long) nearest = nearest_name(name, names);
  input_error("unknown option ", option,
              nearest.empty() ? "; see b3dgs " + name_ + " --help-all" : "; did you mean --" + nearest + "?");
}

nlohmann::ordered_json read_json_file(const std::string& path, const char* expected) {
  std::string text;
  try {
    text = read_whole_file(path);
  } catch (const InputError& error) {
    input_error("expected ", expected, ": ", error.what());
  }
  nlohmann::ordered_json json = parse_json(text, /*ignore_comments=*/true);
  if (json.is_discarded()) input_error("not valid JSON: ", path, " (expected ", expected, "; ", json_damage(text), ")");
  return json;
}

std::string nearest_name(const std::string& name, const std::vector<std::string>& known) {
  if (name.empty()) return "";
  std::string best;
  std::size_t best_distance = std::max<std::size_t>(2, name.size() / 3) + 1;
  for (const std::string& candidate : known) {
    // An abbreviation counts as similar, however short.
    const bool is_abbreviation = name.size() >= 3 && candidate.compare(0, name.size(), name) == 0;
    // So does a name with more words: culling_mode for culling, max_num_iterations for iterations.
    const std::size_t longer = candidate.size() + 1;
    const bool is_longer = name.compare(0, longer, candidate + "_") == 0 ||
                           (name.size() > longer && name.compare(name.size() - longer, longer, "_" + candidate) == 0);
    const std::size_t distance = is_abbreviation || is_longer ? 1 : edit_distance(name, candidate);
    if (distance < best_distance) {
      best = candidate;
      best_distance = distance;
    }
  }
  return best;
}

}  // namespace b3dgs
