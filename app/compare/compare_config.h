// Parses the configurations of a comparison (--configs).
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "app/report/train_log_reader.h"
#include "config/option_layers.h"

namespace b3dgs {

/// Files beside the folders of the configurations.
inline constexpr const char* kComparisonReport = "report.html";

struct Configuration {
  std::string name;  // also the name of its folder
  TrainConfig config;
};

/// A configuration with the logs of all its runs.
struct ConfigurationHistory : Configuration {
  std::vector<TrainHistory> by_seed;
};

/// Reads `--configs`: entries separated by commas, each "[NAME:]PART+PART+...". A part is "option=value" for any
/// training option, the name of a kernel, or `naive-kernels`, the options closest to the original 3DGS trainer. Later
/// parts override earlier ones. An entry without a name is named by its text:
///
///   naive,adaptive,sub-tile+exposure=true,wide:kernel=combined+culling=square,naive-kernels,b:naive-kernels+kernel=dynamic
///
/// Lists are separated by slashes: early:save_iterations=1000/7000. The entry `paper` expands to the two configurations
/// of the Balanced 3DGS paper: naive-kernels,published:naive-kernels+kernel=published.
///
/// `given` are options for all configurations. A configuration's own options override them, so `preset=fast` applies
/// below both (option_layers.h). If `photographs` for training are known, --max_epochs has been applied. `base` has the
/// values that must be the same for all: scene, views, seed, device, ... @throws InputError for fewer than two
/// configurations, a name that occurs twice or cannot be a folder name, an unknown option or value, and options that
/// must be the same for all
std::vector<Configuration> parse_configurations(const std::string& text, const TrainConfig& base,
                                                const GivenOptions& given, const Photographs& photographs = {});

/// The first configuration under another name; training it again measures the run-to-run variation.
/// @throws InputError if that name is taken
Configuration repeat_baseline(const std::vector<Configuration>& configurations);

/// Names of the options in which two configurations differ.
struct DifferingOptions {
  std::vector<std::string> kernel;  // options that affect only the selection of kernels
  std::vector<std::string> others;
  bool empty() const { return kernel.empty() && others.empty(); }
};
DifferingOptions differing_options(const TrainConfig& a, const TrainConfig& b);

}  // namespace b3dgs
