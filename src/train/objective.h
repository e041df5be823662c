// What training minimises: the difference between a render and its photograph, in the colours of its camera, and
// between its inverse depth and the view's depth map.
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

/// Reuses its buffers from view to view; asynchronous on a GPU.
class Objective {
 public:
  /// Reads the depth maps. `config` must outlive this. @throws InputError if they cannot be used
  Objective(const TrainConfig& config, const Scene& scene, torch::Device device, const ProgressFn& progress);

  /// The gradient of the loss with respect to `rendered`, valid until the next call.
  /// @param full_valid  TrainView::valid of the view at its full size
  /// @param wants_errors  errors() will be asked for
  /// @param appearance  of all views; steps of this view that were deferred are applied
  RenderedViewGrad compare(const TrainView& view, int iteration, const torch::Tensor& full_valid,
                           const RenderedView& rendered, bool wants_errors, AppearanceState& appearance);

  /// Of the last compare(), for which this waits on a GPU.
  double value() const { return loss_.value().loss; }
  /// [H, W] of the last compare(): by how much each pixel is wrong (loss.h).
  const torch::Tensor& errors() const { return error_image_.error(); }

  /// How photographs differ because of their cameras, which is learned with the Gaussians; null = not at all.
  AppearanceModel* appearance() { return appearance_ ? &*appearance_ : nullptr; }
  /// Memory on a GPU for each pixel of the largest view, with that of the render.
  std::int64_t bytes_per_pixel() const;
  bool has_depths() const { return depth_priors_.has_value(); }
  /// About depth maps, one line each.
  std::vector<std::string> warnings() const;

 private:
  const TrainConfig& config_;
  ImageLoss loss_;
  ErrorImage error_image_;
  std::optional<AppearanceModel> appearance_;
  std::optional<DepthPriors> depth_priors_;  // with --depths
};

}  // namespace b3dgs
