#include "train/training_views.h"

#include "config/coarse_schedule.h"

namespace b3dgs {

int TrainingViews::scale_at(int iteration, const PinholeView& camera) const {
  return coarse_scale_of(coarse_scale_at(config_, iteration), camera.width, camera.height);
}

TrainView TrainingViews::take(std::int32_t view, int iteration, const std::vector<std::int32_t>& next) {
  TrainView taken = images.take(view, next);
  taken.camera = poses.camera(view);
  const Image8* const mask = scene_.train[static_cast<std::size_t>(view)].valid.get();
  return reducer_.reduce(taken, mask, scale_at(iteration, taken.camera));
}

PinholeView TrainingViews::camera(std::int32_t view, int iteration) {
  const PinholeView camera = poses.camera(view);
  const int scale = scale_at(iteration, camera);
  return scale == 1 ? camera : reduced_camera(camera, scale);
}

}  // namespace b3dgs
