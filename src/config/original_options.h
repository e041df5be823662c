// Options that only the original 3DGS code has. They are accepted, so that its command lines go on working, but they
// have no effect, and one line says so.
#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "core/options/command_line.h"

namespace b3dgs {

/// kTrain has the options of train.py, kModel those of render.py and metrics.py, for `b3dgs render` and `eval`.
enum class OriginalScript { kTrain, kModel };

/// Adds the options of a script. The help does not list them.
void add_original_options(CommandLine& line, OriginalScript script);

/// Returns a line for each such option that was given, unless with its default:
/// "--debug has no effect: only the original 3DGS code has it".
std::vector<std::string> describe_original_options(const nlohmann::ordered_json& given, OriginalScript script);

}  // namespace b3dgs
