#include "app/view/watched_model.h"

#include "app/view/viewed_scene.h"
#include "core/check.h"
#include "raster/kernels.h"

namespace b3dgs {

WatchedModel::WatchedModel(ModelAtRest model, const Scene& scene, ViewedScene viewed)
    : model_(std::move(model)),
      source_(scene),
      viewed_(std::move(viewed)),
      painter_(model_.gaussians.means.device(), viewed_.frame.unit) {}

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

Frame WatchedModel::render(const FrameRequest& request) {
  return queue_.ask(request, std::chrono::seconds(20));
}

Image8 WatchedModel::photograph(int view, ImageSize size) const {
  return resized_photograph(view_at(source_, view), size);
}

void WatchedModel::command(ViewCommand) {
  input_error("this is a model at rest: there is no training to command");
}

}  // namespace b3dgs
