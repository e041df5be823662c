// The header of a checkpoint: everything except the tensors, checked value by value.
#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "config/train_config.h"
#include "config/view_order.h"
#include "config/view_ratios.h"

namespace b3dgs {

struct CheckpointHeader {
  TrainConfig config;
  int iteration = 0;             // the last completed one, at least 0
  std::int64_t n_gaussians = 0;  // at least 1
  int step_iterations = 1;       // of the last step, from 1 to `iteration` and kMaxBatch
  int sh_degree = 0;             // from 0 to config.sh_degree
  std::int64_t adam_steps = 0;   // from 0 to `iteration`
  ViewOrder view_order;          // indices of the scene's training views, each at most once
  ViewRatios view_ratios;        // each finite, at least 0; all 0 in checkpoints of early versions
  double loss_average = 0;       // finite
  double elapsed_s = 0;          // at least 0
  std::string training_id;       // empty in checkpoints of early versions
  bool is_density_pending = false;
  std::int64_t n_removed = 0;         // invalid Gaussians removed so far, at least 0
  std::int64_t held_at = 0;           // number of Gaussians at which GPU memory stopped their growth; 0: it did not
  std::int64_t appearance_steps = 0;  // from 0 to `iteration`
  std::vector<std::int64_t> appearance_last_steps;  // each from 0 to appearance_steps
  nlohmann::ordered_json kernel_selection, scene;
};

/// The value of the header's key "view_ratios", which is missing if no view was counted.
nlohmann::ordered_json ratios_to_json(const ViewRatios& ratios);

/// Reads the values of a checkpoint's header. @throws InputError, beginning with `place`, if one is missing, of the
/// wrong type or out of range
CheckpointHeader parse_checkpoint_header(const nlohmann::ordered_json& header, const std::string& place);

/// For counts and sums of squares. Values that are not finite are accepted: training removes Gaussians that have them,
/// so that a few of these do not make a checkpoint useless. @throws InputError with the tensor and the index of the
/// first negative value
template <class Number>  // float or int32
void check_not_negative(const Number* values, std::int64_t count, const std::string& name, const std::string& place);

}  // namespace b3dgs
