// The header of a training's checkpoint as values: everything but tensors, checked one by one.
#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>
#include <string>

#include "train/config/train_config.h"
#include "train/config/view_order.h"

namespace b3dgs {

struct CheckpointHeader {
  TrainConfig config;
  int iteration = 0;             // last one done, at least 0
  std::int64_t n_gaussians = 0;  // at least 1
  int sh_degree = 0;             // from 0 to the config's
  std::int64_t adam_steps = 0;   // from 0 to `iteration`
  ViewOrder view_order;          // views of the scene, each once
  double loss_average = 0;       // finite
  double elapsed_s = 0;          // at least 0
  std::string training_id;       // empty in checkpoints of early versions
  bool is_density_pending = false;
  std::int64_t n_removed = 0;  // at least 0
  std::int64_t held_at = 0;    // at least 0
  nlohmann::ordered_json kernel_selection, scene;
};

/// Takes the values of a checkpoint's header. @throws InputError, beginning with `place`, if one is missing, of another
/// type or out of its range
CheckpointHeader parse_checkpoint_header(const nlohmann::ordered_json& header, const std::string& place);

/// For counts and sums of squares. Numbers that are not finite pass: a step removes the Gaussians that have them, and a
/// training in which one has gone wrong is not lost for it. @throws InputError that names the tensor and the place of
/// the first negative value
void check_not_negative(const float* values, std::int64_t count, const std::string& name, const std::string& place);
void check_not_negative(const std::int32_t* values, std::int64_t count, const std::string& name,
                        const std::string& place);

}  // namespace b3dgs
