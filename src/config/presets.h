// The values of --preset and of --strategy: tables of options and values as they are written on the command line.
// option_layers.h says which value is used where several name an option.
#pragma once

#include <vector>

namespace b3dgs {

struct OptionValue {
  const char *name, *value;  // "iterations", "7000"
};

struct OptionRow {
  const char* name;  // of the preset or strategy
  const char* summary;
  std::vector<OptionValue> values;
};

/// A row for each name in kPresetNames (train_config.h), in that order. A row may name a strategy.
const std::vector<OptionRow>& presets();

/// Values that a density strategy uses in place of TrainConfig's. Strategies without a row use TrainConfig's.
const std::vector<OptionRow>& strategy_defaults();

}  // namespace b3dgs
