#pragma once

#include <string>
#include <vector>

namespace b3dgs {

/// The known name that a mistyped one most likely stands for; empty if none is similar.
std::string nearest_name(const std::string& name, const std::vector<std::string>& known);

/// The known name of what other trainers call by this name ("output", "total_steps"); empty if there is none.
std::string name_of_other_trainers(const std::string& name, const std::vector<std::string>& known);

}  // namespace b3dgs
