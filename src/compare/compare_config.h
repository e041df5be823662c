// Which configurations a comparison trains.
#pragma once

#include <string>
#include <vector>

#include "train/config/train_config.h"

namespace b3dgs {

struct Configuration {
  std::string name;  // also that of its folder
  TrainConfig config;
};

/// Reads `--configs`: entries between commas, each "[NAME:]PART+PART+...", where a part is "option=value" for any
/// training option, or a bare word, which is a --kernel or `original`: the nearest that this program comes to the
/// original trainer. What stands later wins. An entry without a name is its own name:
///
///   naive,adaptive,shared-memory+tile=16x8,wide:kernel=combined+culling=square,original,b:original+kernel=paper
/// Values of an option that takes several are separated by slashes: paper:kernel_candidates=combined/shared-memory.
///
/// `base` has the options that all share. @throws InputError for fewer than two configurations, a name that occurs
/// twice or cannot name a folder, an unknown option or value, and an option that would change scene, views or length
std::vector<Configuration> parse_configurations(const std::string& text, const TrainConfig& base);

/// The first configuration once more under another name, to see by how much a configuration differs from itself.
/// @throws InputError if that name is taken
Configuration repeat_baseline(const std::vector<Configuration>& configurations);

/// Whether a training of it measures kernels to choose from.
bool measures_kernels(const TrainConfig& config);

/// Options of two configurations that have different values.
struct DifferingOptions {
  std::vector<std::string> forward_kernel;  // names of those that say no more than which forward kernel runs when
  std::vector<std::string> others;
  bool empty() const { return forward_kernel.empty() && others.empty(); }
};
DifferingOptions differing_options(const TrainConfig& a, const TrainConfig& b);

}  // namespace b3dgs
