// Options of `b3dgs train` that earlier versions had, or that only the original 3DGS code has, and former names of
// values. Both are accepted, so that command lines and files go on working; the options have no effect. One line says
// so.
#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "core/options/command_line.h"

namespace b3dgs {

/// They are not listed in the help.
void add_former_options(CommandLine& line);

/// The same for `b3dgs render` and `eval`: options that render.py and metrics.py of the original 3DGS code have.
void add_former_model_options(CommandLine& line);
std::vector<std::string> describe_former_model_options(const nlohmann::ordered_json& options);

/// Without these options, and with the present names of values.
nlohmann::ordered_json present_options(nlohmann::ordered_json options);

/// The present name of the option's value; null if `value` is no former one.
const char* present_name(const std::string& option, const std::string& value);

/// A line for each former option among these, unless it has the value now fixed, and for each former name:
/// "--strategy balanced is now --strategy budget".
std::vector<std::string> describe_former_options(const nlohmann::ordered_json& options);

}  // namespace b3dgs
