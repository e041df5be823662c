#include "train/gaussians/initial_splats.h"

#include "core/check.h"
#include "model/formats/ply.h"
#include "model/formats/splat_formats.h"
#include "train/gaussians/gaussian_model.h"

namespace b3dgs {

SplatCloud initial_splats(const TrainConfig& config, const Scene& scene) {
  PointCloud points;
  std::string place = scene.source_path + ": the COLMAP model";
  if (config.init_ply.empty()) {
    points = scene.points;
  } else if (holds_splats(config.init_ply)) {
    SplatCloud cloud = read_splats(config.init_ply);
    if (cloud.size() == 0) input_error(config.init_ply, ": no Gaussians to start from");
    change_frame(scene.frame, cloud);
    return cloud;
  } else {
    points = in_frame(scene.frame, read_point_ply(config.init_ply));
    place = config.init_ply;
  }
  if (points.size() == 0) {
    input_error(
        place,
        " has no 3D points, and none were found in the photographs; pass some with --init_ply FILE, or triangulate "
        "the scene again");
  }
  SplatCloud cloud = splats_from_points(points, 0, config.init_opacity, config.init_scale);
  cloud.frame = scene.frame;
  return cloud;
}

}  // namespace b3dgs
