// Renders views of a model and measures them.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "model/raster_input.h"
#include "raster/torch/rasterizer.h"
#include "scene/scene.h"
#include "train/config/train_config.h"
#include "train/loss/metrics.h"

namespace b3dgs {

/// The tile that is faster on a device: 16 x 8 px on "cuda", 16 x 16 px elsewhere ("auto" counts as the CPU).
TileShape default_tile(const std::string& device);

/// The tile that the options ask for, on the device they name.
TileShape tile_shape(const TrainConfig& config);

/// How views of a model are rendered where nothing is random. `sh_degree` is at most that of its Gaussians.
RenderSettings evaluation_settings(const TrainConfig& config, int sh_degree);

/// Called after each view with what was rendered (valid until return).
using RenderedFn = std::function<void(std::size_t index, const View&, const RenderedView&, const ImageQuality&)>;

/// Renders each view with `settings` and compares it with its image. Views keep their order.
Evaluation evaluate_views(Rasterizer& rasterizer, const GaussianTensors& gaussians, const std::vector<View>& views,
                          const RenderSettings& settings, const RenderedFn& on_rendered = {});

}  // namespace b3dgs
