// Trains several configurations in turns, so that changes in the speed of the machine affect all of them equally.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

#include "app/common/status_line.h"
#include "app/compare/comparison.h"

namespace b3dgs {

/// Trains all configurations of one seed, with all models in memory at the same time, until the end or a stop signal.
/// After a signal, each has a checkpoint. Each resumes from its newest checkpoint, if it has one. `reading_s` and
/// `machine` are for the reports. Returns whether training is complete.
bool train_in_turns(const ComparisonPlan& plan, std::int64_t seed, const Scene& scene, double reading_s,
                    const nlohmann::ordered_json& machine, StatusLine& status);

/// Returns the command that resumes a comparison: "b3dgs compare --resume -m OUTPUT".
std::string resume_command(const ComparisonPlan& plan);

/// Returns the index of the first configuration in a turn. It advances with each turn and each seed, so that no
/// configuration always trains first.
std::size_t first_in_turn(std::size_t seed_index, int turn, std::size_t n_configurations);

/// Runs a few steps of each configuration on a part of the scene and discards them. Otherwise the time of the first
/// configuration would include loading kernels and libraries.
void warm_up(const ComparisonPlan& plan, const Scene& scene);

}  // namespace b3dgs
