// The dozen lines that tell the user what was loaded.
#pragma once

#include <string>
#include <vector>

#include "scene/colmap/colmap.h"
#include "scene/colmap/model_search.h"
#include "scene/images/image_folder.h"
#include "scene/scene.h"
#include "scene/view_image.h"

namespace b3dgs {

/// What load_scene knows beyond the scene itself.
struct SceneOrigin {
  const SceneOptions& options;
  const SparseModelFolder& model_folder;
  const ColmapModel& model;
  const ImageFolder& image_folder;
  const std::vector<ViewSource>& sources;  // of the images that are on disk
  std::vector<std::string> missing;        // registered names without a file
  std::size_t n_unregistered = 0;          // image files without a name in the model
};

std::vector<std::string> summarize(const Scene& scene, const SceneOrigin& origin);

}  // namespace b3dgs
