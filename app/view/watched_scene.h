// The live view of a scene: the data for the page, frames with the colours of their modes, and a finished model. Only
// one thread renders, in FrameQueue::serve(): the trainer's, between two steps, or the main thread of `b3dgs view`.
#pragma once

#include <torch/types.h>

#include <atomic>
#include <chrono>
#include <string>
#include <utility>
#include <vector>

#include "app/view/frame_source.h"
#include "raster/torch/rasterizer.h"
#include "scene/scene.h"

namespace b3dgs {

/// Returns the cameras of a scene, training views first, and the region of the world with most of the points ([N, 3]).
ViewedScene viewed_scene(const Scene& scene, const std::vector<float>& points, const std::string& title);

/// Returns the view of ViewedScene::views[index].
const View& view_at(const Scene& scene, int index);

class WatchedScene : public FrameSource {
 public:
  const ViewedScene& scene() const override { return viewed_; }
  Frame render(const FrameRequest& request) override { return queue_.ask(request, std::chrono::seconds(20)); }
  Image8 photograph(int view, ImageSize size) const override;
  void close() override { queue_.close(); }

 protected:
  /// `viewed` describes `scene`, which must outlive this.
  WatchedScene(const Scene& scene, ViewedScene viewed, torch::Device device)
      : source_(scene), viewed_(std::move(viewed)), rasterizer_(device) {}

  /// Fills the image, the legend and the time.
  /// @throws InvalidGaussianError naming the first Gaussian that cannot be rendered
  Frame paint(const FrameRequest& request, const GaussianTensors& gaussians, RenderSettings settings);

  const Scene& source_;
  const ViewedScene viewed_;
  FrameQueue queue_;

 private:
  Rasterizer rasterizer_;  // separate, so that the training's rasterizer keeps its data
};

struct ModelAtRest {
  GaussianTensors gaussians;
  RenderSettings settings;
  int iteration = 0;
};

class WatchedModel final : public WatchedScene {
 public:
  /// `viewed` describes `scene`, which must outlive this.
  WatchedModel(const ModelAtRest& model, const Scene& scene, ViewedScene viewed)
      : WatchedScene(scene, std::move(viewed), model.gaussians.means.device()), model_(model) {}

  /// Renders frames for the server's threads on this thread, until `stop_signal` is not 0.
  void run(const std::atomic<int>& stop_signal);

  ViewState state(int since) const override;
  void command(ViewCommand command) override;

 private:
  const ModelAtRest model_;
};

}  // namespace b3dgs
