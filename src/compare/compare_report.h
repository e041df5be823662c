// report.html of a comparison.
#pragma once

#include <nlohmann/json.hpp>

#include "compare/comparison.h"

namespace b3dgs {

/// What the report shows: the results, the runs of all seeds, and texts of the terminal. @throws IoError, InputError if
/// an image cannot be read
nlohmann::ordered_json comparison_report_data(const Comparison& comparison);

}  // namespace b3dgs
