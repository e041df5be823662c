// The live view of a model at rest.
#pragma once

#include <atomic>

#include "app/view/frame_painter.h"
#include "scene/scene.h"
#include "view/frame_queue.h"
#include "view/frame_source.h"

namespace b3dgs {

struct ModelAtRest {
  GaussianTensors gaussians;
  RenderSettings settings;
  int iteration = 0;
};

class WatchedModel final : public FrameSource {
 public:
  /// `viewed` describes `scene`, which must outlive this.
  WatchedModel(ModelAtRest model, const Scene& scene, ViewedScene viewed);

  /// Renders what the server's threads ask for, on this thread, until `stop_signal` is not 0.
  void run(const std::atomic<int>& stop_signal);

  const ViewedScene& scene() const override { return viewed_; }
  ViewState state(int since) const override;
  Frame render(const FrameRequest& request) override;
  Image8 photograph(int view, ImageSize size) const override;
  void command(ViewCommand command) override;
  void close() override { queue_.close(); }

 private:
  const ModelAtRest model_;
  const Scene& source_;
  const ViewedScene viewed_;
  FramePainter painter_;
  FrameQueue queue_;
};

}  // namespace b3dgs
