// Renders views of a model and computes their PSNR and SSIM.
#pragma once

#include <functional>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "config/train_config.h"
#include "model/raster_input.h"
#include "raster/torch/rasterizer.h"
#include "scene/scene.h"
#include "train/quality/metrics.h"

namespace b3dgs {

/// Settings for deterministic rendering, e.g. for evaluation. `sh_degree` is at most that of the Gaussians.
RenderSettings evaluation_settings(const TrainConfig& config, int sh_degree);

/// What is done about colours that differ from the photographs' because of the cameras' settings.
struct ColorEvaluation {
  /// By name of the view: renders of these views are transformed before they are compared.
  std::map<std::string, ColorTransform> exposures{};
  /// All other views are measured on their right half only, with a transform fitted to their left half (fit_colors()).
  bool fit_left_half = false;
  /// Also computes ImageQuality::corrected_psnr, with a transform fitted to the pixels that are measured.
  bool corrected_psnr = false;
};

/// Without transforms of views: what these options say about the others.
ColorEvaluation color_evaluation(const TrainConfig& config);

/// Called after each view with the render, in transformed colours, which is valid until it returns. Views without a
/// valid pixel have no quality.
using RenderedFn =
    std::function<void(std::size_t index, const View&, const RenderedView&, const std::optional<ImageQuality>&)>;

/// Renders a view, on `device`.
using RenderFn = std::function<RenderedView(const CameraView&)>;
/// Renders a view of the model in training. @throws InvalidGaussianError
using RenderModelFn = std::function<RenderedView(const CameraView&, const RenderSettings&)>;

/// Renders each view and compares it with its photograph. Views keep their order; those without a valid pixel are left
/// out of the mean. `lpips`: may be null.
Evaluation evaluate_views(const RenderFn& render, torch::Device device, const std::vector<View>& views,
                          const RenderedFn& on_rendered = {}, const LpipsNetwork* lpips = nullptr,
                          const ColorEvaluation& colors = {});

}  // namespace b3dgs
