// Files of cameras to render from: cameras.json, camera paths and transforms.json.
#include <cmath>

#include "fuzz/fuzz_target.h"
#include "model/cameras/cameras_json.h"

void b3dgs::fuzz::read_input(std::string_view bytes) {
  const CameraFile file = parse_camera_file(std::string(bytes), "nowhere/cameras.json", {640, 480});
  B3DGS_CHECK(!file.cameras.empty() && file.fps >= 0 && file.fps <= 1000, "fps ", file.fps);
  for (const NamedCamera& named : file.cameras) {
    B3DGS_CHECK(camera_fault(named.camera).empty(), camera_fault(named.camera));
    B3DGS_CHECK(named.camera.width > 0 && named.camera.height > 0, "an empty image");
    for (const double value : named.camera.cam_from_world.rotation) B3DGS_CHECK(std::isfinite(value), "not finite");
  }
}
