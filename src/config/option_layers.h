// Computes the options in use from those that the user gave. If several layers set an option, the last one wins:
//
//   1. the defaults of TrainConfig
//   2. the defaults of the density strategy in use (strategy_defaults())
//   3. the values of --preset (presets()), which may also choose the strategy. Without --preset: kDefaultPreset. If a
//      different strategy is given, it is `inria`, because the values of a preset fit its own strategy
//   4. the options that were given: in the file of --config, then on the command line
//
// Schedules: `iterations` of layer 3 scales the schedule options (Steps::kSchedule) that layers 1 and 2 set, by new /
// old iterations. `iterations` of layer 4 scales those of layers 1 to 3, except with preset `inria` and strategy
// `default`, as in the original code. Then --steps_scaler multiplies all options counted in iterations, given or not.
// Once the scene is known, --max_epochs may shorten the schedule (limit_epochs() in schedule.h). --iterations without
// --max_epochs sets the latter to 0.
#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "config/presets.h"
#include "config/schedule.h"
#include "config/train_config.h"
#include "core/options/command_line.h"

namespace b3dgs {

/// Returns the training options given in `config_file` (a path, or empty) and on the command line, which overrides the
/// file. @throws InputError for an invalid file
GivenOptions given_options(const CommandLine& line, const std::string& config_file);

struct OptionLayers {
  TrainConfig config;  // options in use; steps_scaler has been applied and is 1
  GivenOptions given = GivenOptions::object();
  double schedule_scale = 1;  // factor by which a given --iterations scaled the schedule
  double steps_scaler = 1;
  double epoch_scale = 1;  // factor by which limit_epochs() scaled the schedule
};

/// @throws InputError for a given value that is out of range
OptionLayers resolve_options(const GivenOptions& given = GivenOptions::object());

/// Changes the options of a resumed training. Options that are not given keep the checkpoint's values: neither the
/// preset nor the strategy's defaults are applied again, and schedules do not follow a changed --iterations.
/// --iterations without --max_epochs sets max_epochs to 0. --steps_scaler multiplies only given options. So repeating
/// the command line that started the training changes nothing. Returns a line for each given option without effect.
/// @throws InputError if another preset is given, and for a value that is out of range
std::vector<std::string> apply_at_resume(TrainConfig& config, const GivenOptions& given);

/// Returns the options of the config's preset and strategy, with the schedule of its number of iterations. The user or
/// the scene has changed the options that differ from these.
TrainConfig preset_options(const TrainConfig& config);

/// Returns "label       a 1, b 2", broken at commas into lines. The label and the space below it are 12 columns wide.
/// Returns no lines if there are no parts.
std::vector<std::string> wrapped_list(const std::string& label, const std::vector<std::string>& parts,
                                      std::size_t columns = 100);

/// Returns a few lines with labels of 12 columns: preset, strategy, and the given options.
std::vector<std::string> describe_options(const OptionLayers& layers);

}  // namespace b3dgs
