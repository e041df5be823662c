#include "app/view/watched_model.h"

#include "core/check.h"
#include "raster/kernels.h"

namespace b3dgs {

WatchedModel::WatchedModel(ModelAtRest model, const Scene& scene, ViewedScene viewed)
    : WatchedScene(scene, std::move(viewed), model.gaussians.means.device()), model_(std::move(model)) {}

void WatchedModel::run(const std::atomic<int>& stop_signal) {
  const auto paint = [this](const FrameRequest& request) {
    Frame frame = painter_.paint(request, model_.gaussians, model_.settings);
    frame.iteration = model_.iteration;
    return frame;
  };
  while (stop_signal == 0) queue_.serve(paint, std::chrono::milliseconds(100));
}

ViewState WatchedModel::state(int) const {
  ViewState state;
  state.iteration = state.iterations = model_.iteration;
  state.n_gaussians = model_.gaussians.size();
  state.kernel = forward_kernel_name(model_.settings.kernel);
  state.activity = "at rest";
  return state;
}

void WatchedModel::command(ViewCommand) {
  input_error("this is a model at rest: there is no training to command");
}

}  // namespace b3dgs
