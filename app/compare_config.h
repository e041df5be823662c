// Which configurations a comparison trains.
#pragma once

#include <string>
#include <vector>

#include "train/train_config.h"

namespace b3dgs {

struct Configuration {
  std::string name;  // also that of its folder
  TrainConfig config;
};

/// Reads `--configs`: entries between commas, each "[NAME:]PART+PART+...", where a part is "option=value" for any
/// training option, or a bare word, which is a --kernel. An entry without a name is its own name:
///
///   naive,adaptive,shared-memory+tile=16x8,wide:kernel=combined+culling=square
/// Values of an option that takes several are separated by slashes: paper:kernel_candidates=combined/shared-memory.
///
/// `base` has the options that all share. @throws InputError for fewer than two configurations, a name that occurs
/// twice or cannot name a folder, an unknown option or value, and an option that would change scene, views or length
std::vector<Configuration> parse_configurations(const std::string& text, const TrainConfig& base);

}  // namespace b3dgs
