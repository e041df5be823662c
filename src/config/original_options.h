// Options that only the original 3DGS code has. They are accepted, so that its command lines go on working, but they
// have no effect, and one line says so.
#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "core/options/command_line.h"

namespace b3dgs {

/// Adds those of train.py. The help does not list them.
void add_original_train_options(CommandLine& line);
/// Adds those of render.py and metrics.py, for `b3dgs render` and `eval`.
void add_original_model_options(CommandLine& line);

/// Returns a line for each such option that was given, unless with its default:
/// "--debug has no effect: only the original 3DGS code has it".
std::vector<std::string> describe_original_train_options(const nlohmann::ordered_json& given);
std::vector<std::string> describe_original_model_options(const nlohmann::ordered_json& given);

}  // namespace b3dgs
