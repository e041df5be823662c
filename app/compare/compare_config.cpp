#include "app/compare/compare_config.h"

#include <algorithm>
#include <cctype>
#include <type_traits>
#include <utility>

#include "app/report/page_data.h"
#include "config/train_options.h"
#include "core/check.h"
#include "core/options/command_line.h"

namespace b3dgs {
namespace {

/// Options that must be the same for all configurations, because otherwise their times and images would not be
/// comparable, or because they belong to the scene, which is read once.
constexpr const char* kShared[] = {"source_path", "model_path",       "images",         "resolution",
                                   "eval",        "lenses",           "seed",           "device",
                                   "threads",     "white_background", "train_test_exp", "depths",
                                   "masks",       "invert_masks",     "mask_mode",      "host_memory_gb"};

/// Options closest to the original 3DGS trainer. Its loss, optimizer and projection cannot be selected.
constexpr const char* kNaiveKernels = "naive-kernels";

/// An entry that expands to the two configurations of the Balanced 3DGS paper.
constexpr const char *kPaper = "paper", *kPaperEntries[] = {kNaiveKernels, "published:naive-kernels+kernel=published"};

constexpr const char* kKernelOptions[] = {"kernel", "kernel_check_interval"};

std::vector<std::string> split(const std::string& text, char separator) {
  std::vector<std::string> parts;
  std::size_t begin = 0;
  for (std::size_t end; (end = text.find(separator, begin)) != std::string::npos; begin = end + 1) {
    parts.push_back(text.substr(begin, end - begin));
  }
  parts.push_back(text.substr(begin));
  return parts;
}

/// Returns the entries of `--configs`, with `paper` expanded.
std::vector<std::string> entries_of(const std::string& text) {
  std::vector<std::string> entries;
  for (const std::string& entry : split(text, ',')) {
    if (entry == kPaper) {
      entries.insert(entries.end(), std::begin(kPaperEntries), std::end(kPaperEntries));
    } else {
      entries.push_back(entry);
    }
  }
  return entries;
}

struct NamedOption {
  std::string name;
  bool is_list = false;
  const char* prefix = "";  // "no_" of a negated flag
};

/// Returns the option with this name, letter or other name, or the negated name of a flag. @throws InputError if there
/// is none, or configurations may not differ in it
NamedOption find_option(const std::string& key) {
  NamedOption found;
  std::vector<std::string> names;  // possible intended names
  const TrainConfig config;
  visit_fields(config, [&](const Option& option, const auto& value, const auto&, const char*) {
    using Value = std::decay_t<decltype(value)>;
    const std::string name(option.name);
    if (std::find(std::begin(kShared), std::end(kShared), name) == std::end(kShared)) names.push_back(name);
    constexpr bool kIsList = detail::is_vector<Value>::value;
    if (option.has_name(key)) found = {name, kIsList};
    const bool is_negated = std::is_same_v<Value, bool> && (key.rfind("no_", 0) == 0 || key.rfind("no-", 0) == 0);
    if (is_negated && option.has_name(key.substr(3))) found = {name, kIsList, "no_"};
  });
  if (found.name.empty()) {
    const std::string nearest = nearest_name(key, names);
    input_error("unknown training option \"", key, "\"",
                nearest.empty() ? "; see b3dgs train --help-all" : "; did you mean " + nearest + "?");
  }
  if (std::find(names.begin(), names.end(), found.name) == names.end()) {
    input_error(found.name, " must be the same for all configurations; set it for all with --", found.name);
  }
  return found;
}

/// @throws InputError unless --kernel accepts the name
void check_kernel(const std::string& name) {
  std::vector<std::string> names{kNaiveKernels};
  std::string list, meant;
  const TrainConfig config;
  visit_fields(config, [&](const Option& option, const auto&, const auto& constraint, const char*) {
    if constexpr (std::is_same_v<std::decay_t<decltype(constraint)>, OneOf>) {
      const auto& values = constraint.values;
      if (option.name == "kernel") names.insert(names.begin(), values.begin(), values.end());
      const bool is_value = std::find(values.begin(), values.end(), name) != values.end();
      if (is_value && meant.empty()) meant = detail::concat(option.name, "=", name);  // "preset=fast" for "fast"
    }
  });
  if (std::find(names.begin(), names.end(), name) != names.end()) return;
  for (const std::string& own : names) list += own + ", ";
  if (meant.empty()) meant = nearest_name(name, names);
  input_error("unknown configuration \"", name, "\" (expected ", list, "or option=value)",
              meant.empty() ? "" : "; did you mean " + meant + "?");
}

/// Returns an entry's name, which may be its text, and the text of its parts. A name ends at a colon before the first +
/// or =. Later colons belong to values.
std::pair<std::string, std::string> split_name(const std::string& entry) {
  const std::size_t colon = entry.find(':');
  if (colon == std::string::npos || colon >= entry.find_first_of("+=")) return {entry, entry};
  return {entry.substr(0, colon), entry.substr(colon + 1)};
}

/// Adds "culling=square", "combined" or "naive-kernels" as words of a command line. Lists are separated by slashes,
/// because commas separate configurations.
void add_part(const std::string& part, std::vector<std::string>& words) {
  if (part.empty()) input_error("empty part; expected a kernel, naive-kernels or option=value");
  const std::size_t equals = part.find('=');
  if (part == kNaiveKernels) {
    words.insert(words.end(), {"--kernel=naive", "--culling=square"});
  } else if (equals == std::string::npos) {
    check_kernel(part);
    words.push_back("--kernel=" + part);
  } else {
    const NamedOption option = find_option(part.substr(0, equals));
    std::string value = part.substr(equals + 1);
    if (option.is_list) std::replace(value.begin(), value.end(), '/', ',');
    words.push_back(detail::concat("--", option.prefix, option.name, "=", value));
  }
}

/// `configuration` is the entry without its name.
void check_name(const std::string& entry, const std::string& name, const std::string& configuration) {
  const auto is_allowed = [](char c) {
    return std::isalnum(static_cast<unsigned char>(c)) != 0 || std::string_view("_-.+=").find(c) != std::string::npos;
  };
  if (name.empty() || name[0] == '.' || !std::all_of(name.begin(), name.end(), is_allowed)) {
    input_error("--configs ", entry, ": \"", name,
                "\" cannot be a folder name; name it with letters, digits, _ - . + = instead: NAME:", configuration);
  }
  if (name == kComparisonFile || name == kComparisonReport) {
    input_error("--configs ", entry, ": ", name,
                " is the name of a file that the comparison writes; choose another name");
  }
}

Configuration parse_entry(const std::string& entry, const TrainConfig& base, const GivenOptions& given,
                          const Photographs& photographs) {
  const auto [name, parts] = split_name(entry);
  Configuration configuration{name, {}};
  std::vector<std::string> words;
  GivenOptions all = given;
  try {
    for (const std::string& part : split(parts, '+')) add_part(part, words);
    CommandLine line("train", "");
    line.add(TrainConfig{}, "Training");
    line.parse(words);
    all.update(line.given());
    configuration.config = resolve_options(all).config;
    limit_epochs(configuration.config, photographs, all);
  } catch (const InputError& error) {
    input_error("--configs ", entry, ": ", error.what());
  }
  check_name(entry, name, parts);
  nlohmann::ordered_json shared = nlohmann::ordered_json::object();
  const nlohmann::ordered_json base_values = config_to_json(base);
  for (const char* const option : kShared) shared[option] = base_values.at(option);
  config_from_json(configuration.config, shared, /*place=*/"");
  return configuration;
}

}  // namespace

std::vector<Configuration> parse_configurations(const std::string& text, const TrainConfig& base,
                                                const GivenOptions& given, const Photographs& photographs) {
  std::vector<Configuration> configurations;
  for (const std::string& entry : entries_of(text)) {
    const Configuration next = parse_entry(entry, base, given, photographs);
    for (const Configuration& other : configurations) {
      if (other.name != next.name) continue;
      input_error("--configs: ", next.name, " occurs twice; rename one of them: NAME:", split_name(entry).second);
    }
    configurations.push_back(next);
  }
  if (configurations.size() < 2) {
    input_error("--configs ", text, ": a comparison needs at least two configurations; use b3dgs train for one");
  }
  return configurations;
}

Configuration repeat_baseline(const std::vector<Configuration>& configurations) {
  const Configuration& baseline = configurations.front();
  const std::string name = baseline.name + "_again";
  for (const Configuration& other : configurations) {
    if (other.name == name) {
      input_error("--configs: ", name, " is the name that --noise gives to the second training of ", baseline.name,
                  "; choose another name");
    }
  }
  return {name, baseline.config};
}

DifferingOptions differing_options(const TrainConfig& a, const TrainConfig& b) {
  DifferingOptions options;
  std::vector<const void*> others;
  visit_fields(b, [&](const Option&, const auto& value, const auto&, const char*) { others.push_back(&value); });
  auto other = others.begin();
  visit_fields(a, [&](const Option& option, const auto& value, const auto&, const char*) {
    // Both visit their fields in one order, so this is the same field.
    if (value == *static_cast<const std::decay_t<decltype(value)>*>(*other++)) return;
    const bool is_kernel =
        std::find(std::begin(kKernelOptions), std::end(kKernelOptions), option.name) != std::end(kKernelOptions);
    (is_kernel ? options.kernel : options.others).emplace_back(option.name);
  });
  return options;
}

}  // namespace b3dgs
