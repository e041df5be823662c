// The training loss. It compares a render, transformed to the colours of the photograph's camera, with the photograph,
// and its inverse depth with the view's depth map.
#pragma once

#include <torch/types.h>

#include <optional>
#include <string>
#include <vector>

#include "config/train_config.h"
#include "scene/scene.h"
#include "train/appearance/appearance_model.h"
#include "train/depth/depth_priors.h"
#include "train/images/image_store.h"
#include "train/loss/loss.h"

namespace b3dgs {

/// Computes the loss of a view and its gradient. Buffers are reused from view to view. Asynchronous on a GPU.
class Objective {
 public:
  /// Reads the depth maps. `config` must outlive this object. @throws InputError if the depth maps cannot be used
  Objective(const TrainConfig& config, const Scene& scene, torch::Device device, const ProgressFn& progress);

  /// Returns the gradient of the loss with respect to `rendered`, valid until the next call.
  /// @param full_valid  TrainView::valid of the view at its full size
  /// @param wants_errors  whether to compute errors()
  /// @param appearance  state of all views; deferred Adam steps of this view are applied to it
  RenderedViewGrad gradient(const TrainView& view, int iteration, const torch::Tensor& full_valid,
                            const RenderedView& rendered, bool wants_errors, AppearanceState& appearance);

  /// Returns the loss of the last gradient(). Waits for the GPU.
  double value() const { return loss_.value().loss; }
  /// Returns the error of each pixel in the last gradient() with `wants_errors`, [H, W] (loss.h).
  const torch::Tensor& errors() const { return error_image_.error(); }

  /// Returns the model of the photographs' colour differences that is learned with the Gaussians, or null if none is.
  AppearanceModel* appearance() { return appearance_ ? &*appearance_ : nullptr; }
  /// Returns the GPU memory per pixel of the largest view, including the render.
  std::int64_t bytes_per_pixel() const;
  bool has_depths() const { return depth_priors_.has_value(); }
  /// Returns the warnings about depth maps, one line each.
  std::vector<std::string> warnings() const;

 private:
  const TrainConfig& config_;
  ImageLoss loss_;
  ErrorImage error_image_;
  std::optional<AppearanceModel> appearance_;
  std::optional<DepthPriors> depth_priors_;  // with --depths
};

}  // namespace b3dgs
