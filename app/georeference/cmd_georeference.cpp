// b3dgs georeference: puts a scene that COLMAP has made in metres and upright.
#include <iostream>

#include "app/common/commands.h"
#include "app/common/single_option.h"
#include "app/georeference/georeference_scene.h"
#include "app/georeference/gps.h"
#include "core/check.h"
#include "core/files/folders.h"
#include "core/options/command_line.h"
#include "core/text.h"
#include "scene/colmap/colmap.h"
#include "scene/images/image_folder.h"
#include "scene/scene_model.h"

namespace b3dgs {

namespace fs = std::filesystem;

int run_georeference(const std::vector<std::string>& words) {
  CommandLine line(
      "georeference",
      "Put a COLMAP scene in metres, with x to the east, y to the north and z up, by the GPS positions of "
      "its photographs. Writes SCENE/georeference.json, which says where the origin is. `b3dgs reconstruct` "
      "does this by itself.",
      "b3dgs georeference scenes/field");
  SingleOption<std::string> scene_option{Option{"scene"}.common(), "", "scene folder with a COLMAP model"};
  SingleOption<std::string> images{Option{"images", 'i'}.common(), "images", "folder of the photographs in it"};
  line.add(scene_option, "Georeference", {"scene"});
  line.add(images, "Georeference");
  if (!line.parse(words)) return 0;
  if (scene_option.value.empty()) input_error("missing argument: SCENE; usage: b3dgs georeference SCENE");
  if (!can_read_gps()) {
    input_error("this program was built without GPS: install libexiv2-dev and libgeographiclib-dev and build again");
  }
  const fs::path scene = real_path(scene_option.value);
  if (!has_model_folder(scene) && holds_scene(scene)) {
    input_error(scene_option.value, ": expected a COLMAP model, found transforms.json, whose coordinates are kept");
  }
  const fs::path model = find_model_folder(scene).folder;
  if (model == scene) {
    input_error(scene_option.value, ": expected the COLMAP model in sparse/0, found it in the scene folder; move it");
  }
  const ImageFolder folder(scene, images.value);
  const FolderLock lock(scene, "scene folder");
  const GeoreferenceOutcome outcome =
      georeference_scene(scene, model, [&](const std::string& name) { return folder.find(name); });
  if (!outcome.georeference) {
    const std::string none = "no photograph of the model has a GPS position in its EXIF data";
    input_error(scene_option.value, ": ", outcome.why_not.empty() ? none : outcome.why_not, "; the scene is unchanged");
  }
  std::cout << scene_option.value << ": " << outcome.georeference->describe_fit() << "\n"
            << "origin: " << outcome.georeference->describe_origin() << "\n";
  if (!outcome.previous.empty()) std::cout << "the earlier model is in " << outcome.previous.string() << "\n";
  std::cout << "next: b3dgs train " << shell_quote(scene_option.value) << " -m MODEL --eval\n";
  return 0;
}

}  // namespace b3dgs
