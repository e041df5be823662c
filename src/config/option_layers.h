// From what the user gave to the options in use. Where several layers name an option, the later one decides:
//
//   1. TrainConfig's own values
//   2. the defaults of the density strategy in use (strategy_defaults())
//   3. the values of --preset (presets()), which may name the strategy
//   4. what was given: the file of --config, then the command line
//
// Schedules: with a preset other than `original`, a given --iterations scales every option of the schedule that was not
// given itself (Steps::kSchedule, train_config.h) by iterations / the preset's iterations. With `original` they stay
// as they are, as in the original code. Then --steps_scaler multiplies all options counted in iterations, given or not.
// Both round to the nearest whole number, but not to 0; 0 stays 0.
#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "config/presets.h"
#include "config/train_config.h"
#include "core/command_line.h"

namespace b3dgs {

/// Values by option name (its primary one), each of the option's type.
using GivenOptions = nlohmann::ordered_json;

/// The training options among those that the command line gives, on top of those in `config_file` (a path, or empty).
/// @throws InputError for an invalid file
GivenOptions given_options(const CommandLine& line, const std::string& config_file);

/// The options that a row's values name. @throws InputError for an unknown option or a malformed value
GivenOptions parse_values(const std::vector<OptionValue>& values);

struct OptionLayers {
  TrainConfig config;  // the options in use; its steps_scaler is 1, since it has been applied
  GivenOptions strategy = GivenOptions::object(), preset = GivenOptions::object(), given = GivenOptions::object();
  double schedule_scale = 1;  // of a preset's schedule, by a given --iterations
  double steps_scaler = 1;
};

/// @throws InputError for a given value that is out of range
OptionLayers resolve_options(const GivenOptions& given);

/// Changes the options of a resumed training. Those that are not given keep the checkpoint's values: neither the
/// preset nor the strategy's defaults are applied again, and schedules do not follow a changed --iterations. A given
/// --steps_scaler multiplies given options only. So the command line that started a training changes nothing.
/// @throws InputError if another preset is given, and for a value that is out of range
void apply_at_resume(TrainConfig& config, const GivenOptions& given);

/// As one would type it; "none" for an empty text or list, "on" or "off" for a flag.
std::string option_value_text(const nlohmann::ordered_json& value);

/// Preset, strategy, and the options that differ from TrainConfig's by where they are from: a few lines, each with a
/// label of 12 columns.
std::vector<std::string> describe_options(const OptionLayers& layers);

}  // namespace b3dgs
