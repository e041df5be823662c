#pragma once

#include <string>
#include <vector>

namespace b3dgs {

/// The known name that a mistyped one most likely stands for; empty if none is similar.
std::string nearest_name(const std::string& name, const std::vector<std::string>& known);

}  // namespace b3dgs
