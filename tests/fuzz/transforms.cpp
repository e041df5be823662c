// Scenes in transforms.json files.
#include "scene/transforms/transforms.h"

#include <algorithm>

#include "fuzz/colmap_check.h"
#include "fuzz/fuzz_target.h"

void b3dgs::fuzz::read_input(std::string_view bytes) {
  TransformsModel transforms;
  const auto sizes_of = [](const std::string& name) -> PhotographSizes {
    if (name.size() % 3 == 1) return {};  // some photographs are missing
    if (name.size() % 3 == 2) return {{}, ImageSize{32, 24}};
    return {ImageSize{64, 48}};
  };
  read_transforms(bytes, "transforms.json", sizes_of, transforms);
  for (const ColmapImage& image : transforms.model.images) {
    const std::filesystem::path name = image.name;
    B3DGS_CHECK(!name.empty() && name.is_relative(), "the name ", image.name);
    for (const std::filesystem::path& part : name) B3DGS_CHECK(part != "..", "the name ", image.name);
    B3DGS_CHECK(transforms.files.count(image.name) == 1, "no file for ", image.name);
    B3DGS_CHECK(transforms.camera_places.count(image.camera_id) == (image.camera_id > 0 ? 1 : 0),
                "the place of camera ", image.camera_id);
  }
  auto& images = transforms.model.images;
  images.erase(std::remove_if(images.begin(), images.end(), [](const auto& image) { return image.camera_id == 0; }),
               images.end());
  check_model(transforms.model);
}
