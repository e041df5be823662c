// Options of `b3dgs train` that earlier versions had, or that only the original 3DGS code has. They are accepted, so
// that command lines and files go on working, but have no effect; one line says so.
#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "core/options/command_line.h"

namespace b3dgs {

/// They are not listed in the help.
void add_former_options(CommandLine& line);

/// Removes them from options of a file.
nlohmann::ordered_json without_former_options(nlohmann::ordered_json options);

/// A line for each of them among the options, unless it has the value that it always has now.
std::vector<std::string> describe_former_options(const nlohmann::ordered_json& options);

}  // namespace b3dgs
