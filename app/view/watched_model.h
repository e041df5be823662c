// The live view of a model at rest.
#pragma once

#include <atomic>

#include "app/view/viewed_scene.h"

namespace b3dgs {

struct ModelAtRest {
  GaussianTensors gaussians;
  RenderSettings settings;
  int iteration = 0;
};

class WatchedModel final : public WatchedScene {
 public:
  /// `viewed` describes `scene`, which must outlive this.
  WatchedModel(ModelAtRest model, const Scene& scene, ViewedScene viewed);

  /// Renders what the server's threads ask for, on this thread, until `stop_signal` is not 0.
  void run(const std::atomic<int>& stop_signal);

  ViewState state(int since) const override;
  void command(ViewCommand command) override;

 private:
  const ModelAtRest model_;
};

}  // namespace b3dgs
