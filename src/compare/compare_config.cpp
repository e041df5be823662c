#include "compare/compare_config.h"

#include <algorithm>
#include <cctype>
#include <map>
#include <type_traits>
#include <utility>

#include "config/former_options.h"
#include "config/train_options.h"
#include "core/check.h"
#include "core/options/command_line.h"

namespace b3dgs {
namespace {

/// Options that must be the same for all configurations: their times and images would not be comparable otherwise, or
/// the scene, which is read once, has them.
constexpr const char* kShared[] = {"source_path", "model_path",       "images",         "resolution",
                                   "eval",        "lenses",           "seed",           "device",
                                   "threads",     "white_background", "train_test_exp", "depths",
                                   "masks",       "invert_masks",     "mask_mode",      "host_memory_gb"};

/// Options closest to the original 3DGS trainer. Its loss, optimizer and projection cannot be selected.
constexpr const char *kNaiveKernels = "naive-kernels", *kFormerNaiveKernels = "original";
constexpr std::pair<const char*, const char*> kNaiveKernelsOptions[] = {
    {"kernel", "naive"}, {"backward_kernel", "per-pixel"}, {"culling", "square"}};

constexpr const char* kForwardKernelOptions[] = {"kernel", "kernel_policy", "kernel_candidates"};

std::vector<std::string> split(const std::string& text, char separator) {
  std::vector<std::string> parts;
  std::size_t begin = 0;
  for (std::size_t end; (end = text.find(separator, begin)) != std::string::npos; begin = end + 1) {
    parts.push_back(text.substr(begin, end - begin));
  }
  parts.push_back(text.substr(begin));
  return parts;
}

struct FoundOption {
  std::string name;  // the primary one; "" if there is no such option
  bool is_list = false;
};

/// By any of its names.
FoundOption find_option(const std::string& key) {
  const TrainConfig config;
  FoundOption found;
  visit_fields(config, [&](const Option& option, const auto& value, const auto&, const char*) {
    using Value = std::decay_t<decltype(value)>;
    constexpr bool kIsList = !std::is_arithmetic_v<Value> && !std::is_same_v<Value, std::string>;
    if (option.has_name(key)) found = {std::string(option.name), kIsList};
  });
  return found;
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
  return nearest.empty() ? "see b3dgs train --help-all" : "did you mean " + nearest + "?";
}

/// Calls visit(option, group) for each option whose values differ.
template <class Visit>
void visit_differing(const TrainConfig& a, const TrainConfig& b, Visit&& visit) {
  std::vector<const void*> others;
  visit_fields(b, [&](const Option&, const auto& value, const auto&, const char*) { others.push_back(&value); });
  auto other = others.begin();
  std::string_view group;
  visit_fields(a, [&](const Option& option, const auto& value, const auto&, const char*) {
    if (*option.group_name != '\0') group = option.group_name;
    // The fields of both are visited in one order, so this is the same one.
    if (value != *static_cast<const std::decay_t<decltype(value)>*>(*other++)) visit(option, group);
  });
}

using OptionValues = std::map<std::string, std::string>;

/// @throws InputError unless --kernel accepts the name
void check_kernel(const std::string& entry, const std::string& name) {
  std::vector<std::string> names;
  std::string list, meant;
  const TrainConfig config;
  visit_fields(config, [&](const Option& option, const auto&, const auto& constraint, const char*) {
    if constexpr (std::is_same_v<std::decay_t<decltype(constraint)>, OneOf>) {
      if (option.name == "kernel") names.insert(names.end(), constraint.values.begin(), constraint.values.end());
      const bool is_value =
          std::find(constraint.values.begin(), constraint.values.end(), name) != constraint.values.end();
      if (is_value && meant.empty()) meant = detail::concat(option.name, "=", name);  // "preset=fast" for "fast"
    }
  });
  names.emplace_back(kNaiveKernels);
  if (std::find(names.begin(), names.end(), name) != names.end()) return;
  for (const std::string& own : names) list += own + ", ";
  if (meant.empty()) meant = nearest_name(name, names);
  input_error("--configs ", entry, ": unknown configuration \"", name, "\" (expected ", list, "or option=value)",
              meant.empty() ? "" : "; did you mean " + meant + "?");
}

/// The part with present names.
std::string present_part(const std::string& part) {
  if (part == kFormerNaiveKernels) return kNaiveKernels;
  const std::size_t equals = part.find('=');
  const bool is_kernel = equals == std::string::npos;
  const std::string option = is_kernel ? "kernel" : part.substr(0, equals);
  const char* const now = present_name(option, is_kernel ? part : part.substr(equals + 1));
  return now == nullptr ? part : is_kernel ? now : option + "=" + now;
}

/// An entry's name, empty if it is named by its text, and the text of its parts. Only a colon before the first + or =
/// separates a name; later ones belong to values.
std::pair<std::string, std::string> split_name(const std::string& entry) {
  const std::size_t colon = entry.find(':');
  if (colon == std::string::npos || colon >= entry.find_first_of("+=")) return {"", entry};
  return {entry.substr(0, colon), entry.substr(colon + 1)};
}

/// Reads "culling=square", "combined" or "naive-kernels" into `values`. Lists are separated by slashes, since commas
/// separate configurations.
void add_part(const std::string& entry, const std::string& word, OptionValues& values) {
  const std::string part = present_part(word);
  if (part.empty()) input_error("--configs ", entry, ": empty part; expected a kernel, naive-kernels or option=value");
  if (part == kNaiveKernels) {
    for (const auto& [name, value] : kNaiveKernelsOptions) values[name] = value;
    return;
  }
  const std::size_t equals = part.find('=');
  if (equals == std::string::npos) {
    check_kernel(entry, part);
    values["kernel"] = part;
    return;
  }
  const std::string key = part.substr(0, equals);
  const auto [name, is_list] = find_option(key);
  if (name.empty()) {
    input_error("--configs ", entry, ": unknown training option ", key, "; ", unknown_option(key));
  }
  if (is_shared(name)) {
    input_error("--configs ", entry, ": ", name, " must be the same for all configurations; set it for all with --",
                name);
  }
  std::string value = part.substr(equals + 1);
  if (is_list) std::replace(value.begin(), value.end(), '/', ',');
  values[name] = value;
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
  const auto [own_name, parts] = split_name(entry);
  const std::string name = entry.size() == parts.size() ? entry : own_name;
  OptionValues values;
  for (const std::string& part : split(parts, '+')) add_part(entry, part, values);
  std::vector<std::string> words;
  for (const auto& [option, value] : values) words.push_back(detail::concat("--", option, "=", value));
  check_name(entry, name, parts);
  GivenOptions all = given;
  Configuration configuration{name, {}};
  try {
    CommandLine line("compare --configs " + name, "");
    line.add(TrainConfig{}, "Training");
    line.parse(words);
    all.update(line.given());
    configuration.config = resolve_options(all).config;
    limit_epochs(configuration.config, photographs, all);
  } catch (const InputError& error) {
    input_error("--configs ", entry, ": ", error.what());
  }
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
  for (const std::string& entry : split(text, ',')) {
    const Configuration next = parse_entry(entry, base, given, photographs);
    for (const Configuration& other : configurations) {
      if (other.name == next.name) {
        // The name is either the whole entry ("naive") or the part before a colon.
        const std::string parts =
            entry.compare(0, next.name.size() + 1, next.name + ":") == 0 ? entry.substr(next.name.size() + 1) : entry;
        input_error("--configs: ", next.name, " occurs twice; rename one of them: NAME:", parts);
      }
    }
    configurations.push_back(next);
  }
  if (configurations.size() < 2) {
    input_error("--configs ", text, ": a comparison needs at least two configurations; use b3dgs train for one");
  }
  return configurations;
}

std::vector<std::string> describe_former_parts(const std::string& text) {
  std::vector<std::string> lines;
  for (const std::string& entry : split(text, ',')) {
    for (const std::string& part : split(split_name(entry).second, '+')) {
      const std::string now = present_part(part);
      if (now != part) lines.push_back(detail::concat("--configs ", entry, ": ", part, " is now ", now));
    }
  }
  return lines;
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

bool measures_kernels(const TrainConfig& config) {
  return !config.deterministic && (forward_candidates(config).size() > 1 || config.backward_kernel == kAdaptive);
}

DifferingOptions differing_options(const TrainConfig& a, const TrainConfig& b) {
  DifferingOptions options;
  visit_differing(a, b, [&](const Option& option, std::string_view) {
    const std::string name(option.name);
    const bool is_kernel = std::find(std::begin(kForwardKernelOptions), std::end(kForwardKernelOptions), name) !=
                           std::end(kForwardKernelOptions);
    (is_kernel ? options.forward_kernel : options.others).push_back(name);
  });
  return options;
}

bool learns_differently(const TrainConfig& a, const TrainConfig& b) {
  bool differs = false;
  visit_differing(a, b, [&](const Option& option, std::string_view group) {
    differs |= group != "Kernels" && group != "Device and memory" && option.steps != Steps::kOutput &&
               option.name != "preset";  // its values are compared
  });
  return differs;
}

}  // namespace b3dgs
