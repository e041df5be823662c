// Computes the options in use from those that the user gave. If several layers set an option, the last one wins:
//
//   1. the defaults of TrainConfig
//   2. the defaults of the density strategy in use (strategy_defaults())
//   3. the values of --preset (presets()), which may also choose the strategy. Without --preset: kDefaultPreset, or, if
//      another strategy than its own is given, `inria`, since the values of a preset fit its own strategy
//   4. the options that were given: in the file of --config, then on the command line
//
// Schedules: `iterations` of layer 3 scales the options of the schedule (Steps::kSchedule) that layers 1 and 2 set, by
// new / old iterations; `iterations` of layer 4 scales those of layers 1 to 3, except with preset `inria` and
// strategy `default`, as in the original code. Then --steps_scaler multiplies all options counted in iterations, given
// or not. Once the scene is known, --max_epochs may shorten the schedule (limit_epochs() in schedule.h). A given
// --iterations without a given --max_epochs sets that to 0.
#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "config/presets.h"
#include "config/schedule.h"
#include "config/train_config.h"
#include "core/options/command_line.h"

namespace b3dgs {

/// The training options given in `config_file` (a path, or empty) and on the command line, which overrides the file.
/// @throws InputError for an invalid file
GivenOptions given_options(const CommandLine& line, const std::string& config_file);

struct OptionLayers {
  TrainConfig config;  // the options in use; steps_scaler has been applied and is 1
  GivenOptions given = GivenOptions::object();
  double schedule_scale = 1;  // by which a given --iterations scaled the schedule
  double steps_scaler = 1;
  double epoch_scale = 1;  // by which limit_epochs() scaled the schedule
};

/// @throws InputError for a given value that is out of range
OptionLayers resolve_options(const GivenOptions& given = GivenOptions::object());

/// Changes the options of a resumed training. Those that are not given keep the checkpoint's values: neither the
/// preset nor the strategy's defaults are applied again, and schedules do not follow a changed --iterations. A given
/// --iterations without --max_epochs sets max_epochs to 0. A given --steps_scaler multiplies given options only. So
/// repeating the command line that started the training changes nothing. Returns a line for each given option without
/// effect. @throws InputError if another preset is given, and for a value that is out of range
std::vector<std::string> apply_at_resume(TrainConfig& config, const GivenOptions& given);

/// The options of the config's preset and strategy, with the schedule of its number of iterations: what differs from
/// them is what the user, or the scene, has changed.
TrainConfig preset_options(const TrainConfig& config);

/// "label       a 1, b 2", broken at commas into lines, the label and the space below it being 12 columns wide. None
/// for no parts.
std::vector<std::string> wrapped_list(const std::string& label, const std::vector<std::string>& parts,
                                      std::size_t columns = 100);

/// A few lines, each with a label of 12 columns: preset, strategy, and the options that were given.
std::vector<std::string> describe_options(const OptionLayers& layers);

}  // namespace b3dgs
