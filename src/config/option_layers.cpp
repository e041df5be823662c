#include "config/option_layers.h"

#include <algorithm>
#include <utility>

#include "config/train_options.h"
#include "core/check.h"
#include "core/text.h"

namespace b3dgs {
namespace {

/// Returns the values of the preset or strategy with this name, none if it does not exist.
GivenOptions values_of(const std::vector<OptionRow>& rows, const std::string& name) {
  const auto row = std::find_if(rows.begin(), rows.end(), [&](const OptionRow& own) { return own.name == name; });
  return row == rows.end() ? GivenOptions::object() : row->values;
}

/// Returns whether all iterations are trained, however few photographs there are: --iterations without --max_epochs.
bool wants_all_iterations(const GivenOptions& given) {
  return given.contains("iterations") && !given.contains("max_epochs");
}

/// Sets the values. If they include `iterations`, scales the schedule options that they do not include by new / old
/// iterations. Returns that factor.
double apply_scaled(TrainConfig& config, const GivenOptions& values) {
  const double before = config.iterations;
  config_from_json(config, values, /*place=*/"");
  const double factor = config.iterations / before;
  scale_schedule(config, factor, values);
  return factor;
}

}  // namespace

GivenOptions given_options(const CommandLine& line, const std::string& config_file) {
  GivenOptions given = GivenOptions::object();
  const nlohmann::ordered_json file =
      config_file.empty() ? nlohmann::ordered_json::object() : read_json_file(config_file);
  const GivenOptions words = line.given();
  TrainConfig checked;
  if (!config_file.empty()) config_from_json(checked, file, config_file);
  visit_fields(checked, [&](const Option& option, const auto& value, const auto&, const char*) {
    const std::string name(option.name);
    for (const auto& item : file.items()) {
      if (option.has_name(item.key())) given[name] = detail::option_to_json(value);
    }
    if (words.contains(name)) given[name] = words.at(name);
  });
  return given;
}

OptionLayers resolve_options(const GivenOptions& given) {
  OptionLayers layers;
  layers.given = given;
  TrainConfig named;  // the preset and strategy that are named
  const GivenOptions usual = values_of(presets(), kDefaultPreset);
  const bool is_other = given.contains("strategy") && given.at("strategy") != usual.at("strategy");
  named.preset = is_other ? kPresetNames[0] : kDefaultPreset;
  config_from_json(named, given, /*place=*/"");
  const GivenOptions preset = values_of(presets(), named.preset);
  const GivenOptions& names_strategy = given.contains("strategy") ? given : preset;
  const GivenOptions strategy =
      values_of(strategy_defaults(), names_strategy.value("strategy", name_of(named.strategy)));

  TrainConfig& config = layers.config;
  config.preset = named.preset;
  config_from_json(config, strategy, /*place=*/"");
  apply_scaled(config, preset);
  if (strategy.contains("iterations") || preset.contains("iterations")) {
    layers.schedule_scale = apply_scaled(config, given);
  } else {
    config_from_json(config, given, /*place=*/"");
  }
  if (wants_all_iterations(given)) config.max_epochs = 0;
  layers.steps_scaler = std::exchange(config.steps_scaler, 1);
  scale_steps(config, layers.steps_scaler, [](const Option&) { return true; });
  return layers;
}

std::vector<std::string> apply_at_resume(TrainConfig& config, const GivenOptions& given) {
  std::vector<std::string> lines;
  const std::string preset = config.preset;
  const double per_pixel = config.gaussians_per_pixel;
  config_from_json(config, given, /*place=*/"");
  if (config.preset != preset) {
    input_error("--preset ", config.preset, ": the training to resume was started with --preset ", preset,
                "; leave the option out, or start again with --overwrite");
  }
  if (wants_all_iterations(given)) config.max_epochs = 0;
  if (config.max_gaussians > 0 && config.gaussians_per_pixel != per_pixel) {
    lines.push_back(detail::concat("--gaussians_per_pixel ", std::exchange(config.gaussians_per_pixel, per_pixel),
                                   " has no effect: the limit is --max_gaussians ", config.max_gaussians,
                                   "; change that"));
  }
  const double factor = std::exchange(config.steps_scaler, 1);
  bool is_scaled = factor == 1;
  scale_steps(config, factor, [&](const Option& option) {
    const bool is_given = given.contains(std::string(option.name));
    is_scaled = is_scaled || is_given;
    return is_given;
  });
  if (!is_scaled) {
    lines.push_back(detail::concat("--steps_scaler ", factor,
                                   " has no effect: when resuming, it multiplies only options given with it"));
  }
  return lines;
}

TrainConfig preset_options(const TrainConfig& config) {
  GivenOptions named{{"preset", config.preset}, {"strategy", name_of(config.strategy)}};
  TrainConfig options = resolve_options(named).config;
  if (config.iterations != options.iterations) {
    named["iterations"] = config.iterations;
    TrainConfig scaled = resolve_options(named).config;
    scaled.iterations = options.iterations;
    if (config.max_epochs != 0) scaled.max_epochs = options.max_epochs;
    options = scaled;
  }
  // The limit by --lr_decay_from_epoch depends on the number of photographs.
  options.lr_decay_from_iter = std::min(options.lr_decay_from_iter, config.lr_decay_from_iter);
  return options;
}

std::vector<std::string> wrapped_list(const std::string& label, const std::vector<std::string>& parts,
                                      std::size_t columns) {
  constexpr std::size_t kLabelColumns = 12;
  std::vector<std::string> lines;
  std::string line = label + std::string(kLabelColumns - label.size(), ' ');
  for (std::size_t i = 0; i < parts.size(); ++i) {
    const std::string part = parts[i] + (i + 1 < parts.size() ? "," : "");
    if (line.size() > kLabelColumns && line.size() + 1 + part.size() > columns) {
      lines.push_back(line);
      line = std::string(kLabelColumns, ' ');
    }
    line += (line.size() > kLabelColumns ? " " : "") + part;
  }
  if (!parts.empty()) lines.push_back(line);
  return lines;
}

std::vector<std::string> describe_options(const OptionLayers& layers) {
  std::vector<std::string> named{"preset " + layers.config.preset}, given;
  named.push_back("strategy " + name_of(layers.config.strategy));
  if (layers.schedule_scale != 1) {
    named.push_back(print_to_string("its schedule x %.4g for --iterations", layers.schedule_scale));
  } else if (layers.config.preset == kPresetNames[0] && layers.config.strategy == Strategy::kDefault &&
             layers.given.value("iterations", TrainConfig{}.iterations) != TrainConfig{}.iterations) {
    named.emplace_back("schedule of 30,000 iterations, whatever --iterations");
  }
  if (layers.epoch_scale != 1) {
    named.push_back(print_to_string("schedule x %.4g for --max_epochs", layers.epoch_scale));
  }
  if (layers.steps_scaler != 1) {
    named.push_back(print_to_string("all numbers of iterations x %.4g", layers.steps_scaler));
  }
  const nlohmann::ordered_json config = config_to_json(layers.config);
  for (const auto& [name, value] : config.items()) {
    // Paths are printed elsewhere, and preset and strategy above.
    if (name == "source_path" || name == "model_path" || name == "preset" || name == "strategy") continue;
    if (layers.given.contains(name)) given.push_back(name + " " + option_value_text(value));
  }
  std::vector<std::string> lines = wrapped_list("options", named);
  for (const std::string& line : wrapped_list("  given", given)) lines.push_back(line);
  return lines;
}

}  // namespace b3dgs
