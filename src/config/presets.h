// The option values of each --preset, and the defaults of each --strategy. option_layers.h describes which value wins
// if several set the same option.
#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

namespace b3dgs {

struct OptionRow {
  const char* name;  // of the preset or strategy
  const char* summary;
  nlohmann::ordered_json values;  // by primary option name
};

/// Used without --preset and --strategy. docs/benchmarks.md compares it with `inria`.
inline constexpr const char* kDefaultPreset = "quality";

/// Returns a row for each name in kPresetNames (train_config.h), in that order. A row may choose a strategy, whose
/// schedule is scaled to the row's `iterations`.
const std::vector<OptionRow>& presets();

/// Returns the defaults of density strategies that replace TrainConfig's. Strategies without a row use TrainConfig's.
/// Each row has `iterations`, the length of the schedule that a given --iterations scales.
const std::vector<OptionRow>& strategy_defaults();

/// Returns the text for `b3dgs train --help-all` about each preset and each strategy with its own defaults.
std::string presets_help();

/// Returns the section "Presets and strategies" of docs/options.md.
std::string presets_markdown();

}  // namespace b3dgs
