// Presets and strategy defaults for the help text and docs/options.md.
#pragma once

#include <string>

namespace b3dgs {

/// For `b3dgs train --help-all`: a line or more for each preset and each strategy with defaults of its own.
std::string presets_help();

/// The section "Presets and strategies" of docs/options.md.
std::string presets_markdown();

}  // namespace b3dgs
