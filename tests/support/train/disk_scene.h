// The tiny scene as a COLMAP folder, which can be loaded with any memory limit for its photographs.
#pragma once

#include <algorithm>
#include <cstring>

#include "scene/colmap/colmap.h"
#include "scene/images/image.h"
#include "support/temp_dir.h"
#include "support/train/tiny_scene.h"

namespace b3dgs::test {

class DiskScene {
 public:
  /// With `distorted`, the camera has lens distortion, so that undistorted photographs have a mask.
  explicit DiskScene(bool distorted = false, const TinySceneOptions& options = {}) {
    Scene tiny = make_tiny_scene(options);
    std::vector<View> views = tiny.train;
    views.insert(views.end(), tiny.test.begin(), tiny.test.end());
    const Camera& shared = views.front().camera;
    ColmapModel model;
    model.cameras[1] = {1,
                        CameraModel::kOpenCv,
                        static_cast<std::uint64_t>(shared.width),
                        static_cast<std::uint64_t>(shared.height),
                        {shared.fx, shared.fy, shared.cx, shared.cy, distorted ? 0.3 : 0, 0, 0, 0}};
    for (const View& view : views) {
      model.images.push_back({static_cast<std::uint32_t>(model.images.size() + 1),
                              quaternion_from_rotation(view.camera.cam_from_world.rotation),
                              view.camera.cam_from_world.translation, 1, view.name});
      write_image(folder_ / "images" / view.name, *view.image->held());
    }
    for (std::int64_t i = 0; i < tiny.points.size(); ++i) {
      ColmapPoint point;
      point.id = static_cast<std::uint64_t>(i + 1);
      for (std::size_t c = 0; c < 3; ++c) {
        point.position[c] = tiny.points.positions[static_cast<std::size_t>(3 * i) + c];
        point.color[c] = tiny.points.colors[static_cast<std::size_t>(3 * i) + c];
      }
      model.points.push_back(point);
    }
    write_colmap_model(folder_ / "sparse/0", model, ColmapFormat::kBinary);
    image_bytes_ = std::int64_t{3} * shared.width * shared.height;
  }

  std::int64_t image_bytes() const { return image_bytes_; }  // of a decoded photograph

  /// Loads the scene with host memory for that many photographs, plus the data that is always in memory.
  Scene load(double photographs = 1e6) const {
    SceneOptions options;
    options.source_path = folder_.path().string();
    options.eval = true;
    options.host_memory_gb = 0;
    const auto fixed = static_cast<double>(load_scene(options).train.front().image->memory()->used());
    options.host_memory_gb = 1e-9 * (fixed + photographs * static_cast<double>(image_bytes_));
    return load_scene(options);
  }

  std::filesystem::path image_file(const View& view) const { return folder_ / "images" / view.name; }

 private:
  TempDir folder_;
  std::int64_t image_bytes_ = 0;
};

}  // namespace b3dgs::test
