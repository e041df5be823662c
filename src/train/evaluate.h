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

/// Returns the settings for renders without random parts, as for evaluation: the configured background and kernel.
/// `sh_degree` must not exceed that of the Gaussians.
RenderSettings base_render_settings(const TrainConfig& config, int sh_degree);

/// How to compare renders with photographs whose colours differ because of the cameras' settings.
struct ColorEvaluation {
  /// Colour transforms by name of the view, applied to the renders of these views before the comparison.
  std::map<std::string, ColorTransform> exposures{};
  /// Measures all other views on their right half only, after a colour transform fitted to their left half
  /// (fit_colors()).
  bool fit_left_half = false;
  /// Also computes ImageQuality::corrected_psnr, with a colour transform fitted to the measured pixels.
  bool corrected_psnr = false;
};

/// Returns the settings that follow from the options, without `exposures`.
ColorEvaluation color_evaluation(const TrainConfig& config);

/// Called after each view with its render, in transformed colours, which is valid until the function returns. A view
/// without a valid pixel has no quality.
using RenderedFn =
    std::function<void(std::size_t index, const View&, const RenderedView&, const std::optional<ImageQuality>&)>;

/// Renders a view on the device passed to evaluate_views().
using RenderFn = std::function<RenderedView(const CameraView&)>;
/// Renders a view of the model in training. @throws InvalidGaussianError
using RenderModelFn = std::function<RenderedView(const CameraView&, const RenderSettings&)>;

/// Renders each view and compares it with its photograph. Results are in the order of `views`. Views without a valid
/// pixel are listed apart and do not count towards the mean. `lpips` may be null.
/// @throws InputError if a photograph cannot be read
Evaluation evaluate_views(const RenderFn& render, torch::Device device, const std::vector<View>& views,
                          const RenderedFn& on_rendered = {}, const LpipsNetwork* lpips = nullptr,
                          const ColorEvaluation& colors = {});

}  // namespace b3dgs
