// report.html of a comparison.
#pragma once

#include <string>

#include "compare/comparison.h"

namespace b3dgs {

/// The page; its headline is the verdict.
std::string comparison_report(const Comparison& comparison);

}  // namespace b3dgs
