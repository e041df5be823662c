#pragma once

#include <nlohmann/json.hpp>
#include <string>

#include "core/config.h"

namespace b3dgs {

/// Reads a --config file: a JSON object with option names as keys; // comments are allowed. @throws InputError
nlohmann::ordered_json read_json_file(const std::string& path);

/// Sets the fields of `config` that a --config file names. @throws InputError
template <class Config>
void apply_config_file(Config& config, const std::string& path) {
  config_from_json(config, read_json_file(path), path);
}

}  // namespace b3dgs
