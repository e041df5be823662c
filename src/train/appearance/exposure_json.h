// exposure.json: the colour transforms of a model's training views (--exposure), as the original 3DGS code writes them:
// an object from the name of the view to the rows of its transform [3, 4], colour' = transform (r, g, b, 1). The PLY
// does not include them.
#pragma once

#include <torch/types.h>

#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "scene/scene.h"
#include "train/quality/color_fit.h"

namespace b3dgs {

/// By name of the view.
using Exposures = std::map<std::string, ColorTransform>;

/// `exposures` [V, 3, 4] of these views, in their order.
Exposures named_exposures(const torch::Tensor& exposures, const std::vector<View>& views);

/// @throws IoError
void write_exposures(const std::filesystem::path& path, const Exposures& exposures);

/// @throws InputError if the file cannot be read, or is damaged
Exposures read_exposures(const std::filesystem::path& path);

}  // namespace b3dgs
