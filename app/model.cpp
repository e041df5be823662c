#include "app/model.h"

#include <algorithm>
#include <cstdio>

#include "check.h"
#include "scene/ply.h"
#include "train/threads.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

int choose_iteration(const ModelFolder& folder, int wanted) {
  const std::vector<int> saved = folder.ply_iterations();
  if (saved.empty()) {
    input_error(folder.root().string(),
                ": no trained model here (no point_cloud/iteration_N); train one with b3dgs train");
  }
  if (wanted < 0) return saved.back();
  if (std::find(saved.begin(), saved.end(), wanted) != saved.end()) return wanted;
  std::string list;
  for (const int iteration : saved) list += (list.empty() ? "" : ", ") + std::to_string(iteration);
  input_error(folder.root().string(), ": no iteration ", wanted, "; saved are ", list);
}

void load_scene_of(LoadedModel& model, const ModelOptions& options, StatusLine& status) {
  if (!options.source_path.empty()) model.config.source_path = options.source_path;
  if (options.resolution != 0) model.config.resolution = options.resolution;
  set_compute_threads(options.threads);
  model.scene = load_scene(scene_options(model.config), show_loading(status));
  status.clear();
}

}  // namespace

LoadedModel load_model(const ModelOptions& options, StatusLine& status) {
  if (options.model_path.empty()) input_error("command line: which model? Name its folder with -m");
  LoadedModel model;
  model.folder = ModelFolder(options.model_path);
  if (!fs::is_directory(options.model_path)) input_error(options.model_path, ": no such folder");
  model.iteration = choose_iteration(model.folder, options.iteration);
  model.config = model.folder.read_config();
  model.splats = read_splat_ply(model.folder.ply(model.iteration));
  load_scene_of(model, options, status);
  return model;
}

LoadedModel load_ply_model(const fs::path& ply, const ModelOptions& options, StatusLine& status) {
  if (options.source_path.empty())
    input_error("command line: --ply needs the scene that has the cameras; name it with -s");
  LoadedModel model;
  model.splats = read_splat_ply(ply);
  load_scene_of(model, options, status);
  return model;
}

SceneOptions scene_options(const TrainConfig& config) {
  SceneOptions options;
  options.source_path = config.source_path;
  options.images = config.images;
  options.resolution = config.resolution;
  options.eval = config.eval;
  options.white_background = config.white_background;
  options.host_memory_gb = config.host_memory_gb;
  return options;
}

fs::path image_folder(const LoadedModel& model, const std::string& set) {
  return model.folder.root() / set / ("ours_" + std::to_string(model.iteration));
}

std::string image_name(std::size_t index) {
  char name[32];
  std::snprintf(name, sizeof name, "%05zu.png", index);
  return name;
}

}  // namespace b3dgs
