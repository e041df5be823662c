#include "app/compare_config.h"

#include <algorithm>
#include <cctype>
#include <type_traits>

#include "app/cli.h"
#include "check.h"

namespace b3dgs {
namespace {

/// What has to be the same for all, or the times would not compare.
constexpr const char* kShared[] = {"source_path", "model_path", "images",     "resolution", "eval",
                                   "seed",        "device",     "iterations", "threads",    "white_background"};

std::vector<std::string> split(const std::string& text, char separator) {
  std::vector<std::string> parts;
  std::size_t begin = 0;
  for (std::size_t end; (end = text.find(separator, begin)) != std::string::npos; begin = end + 1) {
    parts.push_back(text.substr(begin, end - begin));
  }
  parts.push_back(text.substr(begin));
  return parts;
}

/// The option's own name for one of its names; "" for an unknown one.
std::string canonical_name(const std::string& key) {
  const TrainConfig config;
  std::string name;
  visit_fields(config, [&](const Option& option, const auto&, const auto&, const char*) {
    if (option.has_name(key)) name = option.name;
  });
  return name;
}

bool is_shared(const std::string& name) {
  return std::find(std::begin(kShared), std::end(kShared), name) != std::end(kShared);
}

std::string unknown_option(const std::string& key) {
  const TrainConfig config;
  std::vector<std::string> names;
  visit_fields(config, [&](const Option& option, const auto&, const auto&, const char*) {
    if (!is_shared(std::string(option.name))) names.emplace_back(option.name);
  });
  const std::string nearest = nearest_name(key, names);
  return nearest.empty() ? "b3dgs train --help lists them" : "did you mean " + nearest + "?";
}

bool is_list(const std::string& name) {
  const TrainConfig config;
  bool found = false;
  visit_fields(config, [&](const Option& option, const auto& value, const auto&, const char*) {
    using Value = std::decay_t<decltype(value)>;
    constexpr bool kIsList = !std::is_arithmetic_v<Value> && !std::is_same_v<Value, std::string>;
    found = found || (kIsList && option.name == name);
  });
  return found;
}

/// "tile=16x8" or "combined" as a word of a command line. Commas separate configurations, so lists have slashes.
std::string to_word(const std::string& entry, const std::string& part) {
  if (part.empty())
    input_error("command line: --configs ", entry, ": an empty part; expected a kernel or option=value");
  const std::size_t equals = part.find('=');
  if (equals == std::string::npos) return "--kernel=" + part;
  const std::string key = part.substr(0, equals), name = canonical_name(key);
  if (name.empty()) {
    input_error("command line: --configs ", entry, ": no training option is called ", key, "; ", unknown_option(key));
  }
  if (is_shared(name)) {
    input_error("command line: --configs ", entry, ": ", name,
                " has to be the same for all configurations; give it as --", name);
  }
  std::string value = part.substr(equals);
  if (is_list(name)) std::replace(value.begin(), value.end(), '/', ',');
  return "--" + name + value;
}

/// `configuration` is the entry without its name.
void check_name(const std::string& entry, const std::string& name, const std::string& configuration) {
  const auto is_allowed = [](char c) {
    return std::isalnum(static_cast<unsigned char>(c)) != 0 || std::string_view("_-.+=").find(c) != std::string::npos;
  };
  if (name.empty() || name[0] == '.' || !std::all_of(name.begin(), name.end(), is_allowed)) {
    input_error("command line: --configs ", entry, ": \"", name,
                "\" cannot name a folder; give it a name of letters, digits, _ - . + = instead: NAME:", configuration);
  }
}

Configuration parse_entry(const std::string& entry, const TrainConfig& base) {
  // A colon before the first part's end ends a name; later ones belong to values.
  const std::size_t colon = entry.find(':');
  const bool is_named = colon != std::string::npos && colon < entry.find_first_of("+=");
  const std::string name = is_named ? entry.substr(0, colon) : entry;
  std::vector<std::string> words;
  const std::string parts = is_named ? entry.substr(colon + 1) : entry;
  for (const std::string& part : split(parts, '+')) words.push_back(to_word(entry, part));
  check_name(entry, name, parts);
  CommandLine line("compare --configs " + name, "");
  line.add(TrainConfig{}, "Training");
  line.parse(words);
  Configuration configuration{name, base};
  line.apply(configuration.config);
  return configuration;
}

}  // namespace

std::vector<Configuration> parse_configurations(const std::string& text, const TrainConfig& base) {
  std::vector<Configuration> configurations;
  for (const std::string& entry : split(text, ',')) {
    const Configuration next = parse_entry(entry, base);
    for (const Configuration& other : configurations) {
      if (other.name == next.name) {
        // The name may be that of an entry as a whole: "naive", or of one that has it before a colon.
        const std::string parts =
            entry.compare(0, next.name.size() + 1, next.name + ":") == 0 ? entry.substr(next.name.size() + 1) : entry;
        input_error("command line: --configs: ", next.name, " occurs twice; give one another name: NAME:", parts);
      }
    }
    configurations.push_back(next);
  }
  if (configurations.size() < 2) {
    input_error("command line: --configs ", text, ": a comparison takes at least two; b3dgs train trains a single one");
  }
  return configurations;
}

}  // namespace b3dgs
