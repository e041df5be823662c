// About a dozen lines that describe a scene to the user.
#pragma once

#include <string>
#include <vector>

#include "scene/images/image_folder.h"
#include "scene/scene.h"
#include "scene/scene_model.h"
#include "scene/view_image.h"

namespace b3dgs {

/// Intermediate results of load_scene() that are not part of the scene.
struct SceneOrigin {
  const SceneOptions& options;
  const SceneModel& model;
  const ImageFolder& image_folder;
  const std::vector<ViewSource>& sources;  // photographs that are on disk, sorted by name
  std::vector<std::string> missing;        // registered names without a file
  std::size_t n_unregistered = 0;          // image files that the model does not name
};

std::vector<std::string> summarize(const Scene& scene, const SceneOrigin& origin);

}  // namespace b3dgs
