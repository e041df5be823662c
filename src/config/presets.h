// The option values of each --preset, and the defaults of each --strategy. option_layers.h says which value wins if
// several set the same option.
#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

namespace b3dgs {

struct OptionRow {
  const char* name;  // of the preset or strategy
  const char* summary;
  nlohmann::ordered_json values;  // by the options' primary names
};

/// Without --preset and --strategy. docs/benchmarks.md says what it gains over `inria`.
inline constexpr const char* kDefaultPreset = "quality";

/// A row for each name in kPresetNames (train_config.h), in that order. A row may choose a strategy, whose schedule is
/// scaled to the row's `iterations`.
const std::vector<OptionRow>& presets();

/// Defaults of density strategies in place of TrainConfig's. Strategies without a row use TrainConfig's. Each row has
/// `iterations`: those of the schedule that a given --iterations scales.
const std::vector<OptionRow>& strategy_defaults();

/// For `b3dgs train --help-all`: a line or more for each preset and each strategy with defaults of its own.
std::string presets_help();

/// The section "Presets and strategies" of docs/options.md.
std::string presets_markdown();

}  // namespace b3dgs
