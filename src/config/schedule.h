// Changes the length of a training by multiplying options counted in iterations. Products are rounded to the nearest
// integer, but to no less than 1. 0 stays 0. Products that do not fit throw InputError.
#pragma once

#include <cstddef>
#include <functional>
#include <nlohmann/json.hpp>
#include <string>

#include "config/train_config.h"

namespace b3dgs {

struct Option;

/// Values by primary option name, each of the option's type.
using GivenOptions = nlohmann::ordered_json;

/// Multiplies the options counted in iterations for which is_wanted(option) holds.
void scale_steps(TrainConfig& config, double factor, const std::function<bool(const Option&)>& is_wanted);

/// Multiplies the options of the schedule (Steps::kSchedule) that are not in `given`.
void scale_schedule(TrainConfig& config, double factor, const GivenOptions& given);

/// The training photographs, as far as the length of a training depends on them.
struct Photographs {
  std::size_t n = 0;
  double overlap = 0;  // average number of photographs that show the same point (docs/recipes.md), from 1 to n

  Photographs() = default;
  Photographs(std::size_t count) : n(count), overlap(static_cast<double>(count)) {}  // all show the same
  Photographs(std::size_t count, double same) : n(count), overlap(same) {}
};

/// Applies --max_epochs X, which limits how often training uses each of n photographs. If `given` has max_epochs, the
/// limit is X uses. Otherwise it is
///   min(X, max(X m / 50, 500 / n)) uses, rounded, at least 1
/// where m is the overlap, because training overfits sooner if fewer photographs show the same point
/// (docs/benchmarks.md, Few photographs). If training would exceed the limit, --iterations is lowered to it, even if it
/// is in `given`, and the schedule is scaled by the same factor, except for options in `given`. An iteration uses one
/// photograph, also with --batch. X = 0 means no limit. Returns the factor, 1 without a change. A second call changes
/// nothing.
double limit_epochs(TrainConfig& config, const Photographs& photographs, const GivenOptions& given);

/// Returns "schedule    8,400 iterations: each photograph 400 times (--max_epochs)" if training ends there, or "".
std::string describe_epochs(const TrainConfig& config, const Photographs& photographs);

}  // namespace b3dgs
