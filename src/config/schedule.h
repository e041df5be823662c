// Changes the length of a training: multiplies options counted in iterations. Products are rounded to the nearest
// integer, but to no less than 1; 0 stays 0. Products that do not fit throw InputError.
#pragma once

#include <cstddef>
#include <functional>
#include <nlohmann/json.hpp>
#include <string>

#include "config/train_config.h"

namespace b3dgs {

struct Option;

/// Values by the option's primary name, each of the option's type.
using GivenOptions = nlohmann::ordered_json;

/// Multiplies the options counted in iterations for which is_wanted(option) holds.
void scale_steps(TrainConfig& config, double factor, const std::function<bool(const Option&)>& is_wanted);

/// Multiplies the options of the schedule (Steps::kSchedule) that are not in `given`.
void scale_schedule(TrainConfig& config, double factor, const GivenOptions& given);

/// The training photographs, as far as the length of a training depends on them.
struct Photographs {
  std::size_t n = 0;
  double overlap = 0;  // how many of them show the same point, on average (docs/recipes.md): from 1 to n

  Photographs() = default;
  Photographs(std::size_t count) : n(count), overlap(static_cast<double>(count)) {}  // all show the same
  Photographs(std::size_t count, double same) : n(count), overlap(same) {}
};

/// --max_epochs X: if training would use each of its photographs more than X times, it ends after that many uses, and
/// the schedule is scaled by the same factor, except for options in `given`. If `given` lacks max_epochs and X is not
/// 0, the limit with an overlap m < 50 is X m / 50 uses, or as many as 500 iterations need, if that is more: the fewer
/// photographs show the same point, the sooner training overfits them (docs/benchmarks.md, Few photographs). An
/// iteration uses one photograph, also with --batch. Returns the factor, 1 without a change; applying it again changes
/// nothing.
double limit_epochs(TrainConfig& config, const Photographs& photographs, const GivenOptions& given);

/// "schedule    8,400 iterations: each photograph 400 times (--max_epochs)" if training ends there, otherwise empty.
std::string describe_epochs(const TrainConfig& config, const Photographs& photographs);

}  // namespace b3dgs
