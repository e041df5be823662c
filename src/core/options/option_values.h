// Values of options as JSON, from the words of the command line.
#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "core/options/option_spec.h"

namespace b3dgs {

/// "true" or "false".
bool is_truth_value(const std::string& word);

/// The value of an option that was given with these words. Entries of a list are separated by commas, spaces or both.
/// @throws InputError that names the option
nlohmann::json option_value(const OptionSpec& spec, const std::vector<std::string>& words);

}  // namespace b3dgs
