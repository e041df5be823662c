// Renders views of a model and computes their PSNR and SSIM.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "config/train_config.h"
#include "model/raster_input.h"
#include "raster/torch/rasterizer.h"
#include "scene/scene.h"
#include "train/background/background.h"
#include "train/quality/lpips.h"
#include "train/quality/metrics.h"

namespace b3dgs {

/// The faster tile size for a device: 16 x 8 px on "cuda", 16 x 16 px otherwise ("auto" counts as the CPU).
TileShape default_tile(const std::string& device);

/// The tile size that the options select, for the device that they name.
TileShape tile_shape(const TrainConfig& config);

/// Settings for deterministic rendering, e.g. for evaluation. `sh_degree` is at most that of the Gaussians.
RenderSettings evaluation_settings(const TrainConfig& config, int sh_degree);

/// Called after each view with the render, which is valid until it returns.
using RenderedFn = std::function<void(std::size_t index, const View&, const RenderedView&, const ImageQuality&)>;

/// Renders each view with `settings` and compares it with its photograph. Views keep their order. `lpips`: may be null.
/// `background`: the coefficients of a learned background (add_background()), or undefined.
Evaluation evaluate_views(Rasterizer& rasterizer, const GaussianTensors& gaussians, const std::vector<View>& views,
                          const RenderSettings& settings, const RenderedFn& on_rendered = {},
                          const LpipsNetwork* lpips = nullptr, const torch::Tensor& background = {});

}  // namespace b3dgs
