#include "app/common/torch/model.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>

#include "core/check.h"
#include "core/files/atomic_file.h"
#include "core/files/folders.h"
#include "core/json_text.h"
#include "core/parallel.h"
#include "core/text.h"
#include "model/cameras/cameras_json.h"
#include "scene/cameras/coordinate_frame.h"
#include "train/checkpoint/checkpoint.h"
#include "train/device.h"
#include "train/evaluate.h"
#include "train/gaussians/gaussian_model.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

/// Returns the command that writes the PLY of a checkpoint.
std::string words_for_ply(const fs::path& checkpoint, std::int64_t iteration) {
  return detail::concat("b3dgs train --resume ", shell_quote(checkpoint.string()), " --iterations ", iteration);
}

int choose_iteration(const ModelFolder& folder, int wanted) {
  const std::vector<int> saved = folder.ply_iterations(), stopped = folder.checkpoint_iterations();
  const std::string root = folder.root().string();
  if (saved.empty() && !stopped.empty()) {
    const fs::path last = folder.checkpoint(stopped.back());
    input_error("no PLY in ", root, ": the training was interrupted at iteration ", stopped.back(),
                "; continue with b3dgs train --resume ", shell_quote(last.string()),
                ", or write the PLY of this iteration with ", words_for_ply(last, stopped.back()));
  }
  if (saved.empty()) {
    input_error("no trained model: ", root, " (expected point_cloud/iteration_N/); train one with b3dgs train");
  }
  if (wanted < 0) return saved.back();
  if (std::find(saved.begin(), saved.end(), wanted) != saved.end()) return wanted;
  input_error("iteration ", wanted, " was not saved: ", root, " (found ", list_text(saved), ")");
}

LoadedModel read_folder(const std::string& root, int iteration) {
  if (root.empty()) input_error("missing argument: MODEL_PATH (expected a model folder or a file of Gaussians)");
  if (!fs::exists(root)) input_error("model folder not found: ", root);
  if (!fs::is_directory(root)) input_error("not a directory: ", root, " (expected a model folder)");
  LoadedModel model;
  model.folder = ModelFolder(root);
  model.iteration = choose_iteration(model.folder, iteration);
  if (!model.folder.has_config()) {
    const std::string file = model.folder.ply(model.iteration).string();
    input_error(model.folder.root().string(),
                ": has no config.json: not a model of b3dgs train; to use its Gaussians, ",
                "name the file and the scene: ", shell_quote(file), " -s SCENE");
  }
  model.config = model.folder.read_config();
  model.splats = read_splat_ply(model.folder.ply(model.iteration));
  return model;
}

LoadedModel read_file(const fs::path& file) {
  if (file.extension() == ".b3dgs") {
    input_error(file.string(), ": a checkpoint, which only b3dgs train reads (expected a file of Gaussians); ",
                "write its PLY with ", words_for_ply(file, read_checkpoint_header(file).value("iteration", 0)));
  }
  LoadedModel model;
  model.file = file;
  model.splats = read_splats(file);
  return model;
}

/// Returns the iteration of the model folder whose PLY the file is; nothing for other files.
std::optional<int> iteration_of(const ModelFolder& folder, const fs::path& file) {
  if (!folder.has_config()) return std::nullopt;
  for (const int iteration : folder.ply_iterations()) {
    std::error_code error;
    if (fs::equivalent(folder.ply(iteration), file, error)) return iteration;
  }
  return std::nullopt;
}

LoadedModel read_model(const ModelOptions& options, bool needs_views) {
  const fs::path path = options.model_path;
  const bool is_missing_file = !fs::exists(path) && splat_format(path).has_value();
  if (!fs::is_regular_file(path) && !is_missing_file) return read_folder(options.model_path, options.iteration);
  if (options.iteration >= 0) {
    input_error("--iteration selects a PLY of a model folder, but a file is named already; leave out one of them");
  }
  if (options.source_path.empty()) {
    const fs::path root = fs::absolute(path).parent_path().parent_path().parent_path();
    if (const auto iteration = iteration_of(ModelFolder(root), path)) return read_folder(root.string(), *iteration);
    if (needs_views) {
      input_error("no cameras for ", path.string(),
                  "; name a scene with -s (expected a model folder, or a scene beside the file; render also takes "
                  "--cameras or --path turntable)");
    }
  }
  return read_file(path);
}

bool views_are_as_trained(const ModelOptions& options) {
  return options.source_path.empty() && options.resolution == 0 && options.lenses == "trained";
}

/// Gives the training views the poses that the model was trained with, if --pose_opt refined them.
void refine_poses(LoadedModel& model) {
  if (!model.is_file() && fs::exists(model.folder.poses()))
    apply_refined_poses(model.folder.poses(), model.scene.train, model.scene.frame);
}

/// Expresses the views in the frame of the Gaussians, and converts --near_plane to its units. If neither the folder nor
/// a scene has the unit of the training, it is estimated from the Gaussians, and may differ a little.
void use_frame_of_gaussians(LoadedModel& model) {
  constexpr std::size_t kSamples = 20000;
  Scene& scene = model.scene;
  if (!scene.options) {  // not from load_scene(), which chooses a frame: cameras of a file, or none
    std::vector<Camera> cameras;
    for (const View& view : scene.train) cameras.push_back(view.camera);
    change_frame_of_views(choose_frame(cameras, world_positions(model.splats, kSamples)), scene);
  }
  if (!model.is_file()) scene.georeference = read_georeference(model.folder.root());
  const std::optional<double> unit = model.is_file() ? std::nullopt : model.folder.training_unit();
  model.near_plane = model.config.near_plane * unit.value_or(scene.frame.unit) / model.splats.frame.unit;
  change_frame_of_views(model.splats.frame, scene);
  scene.points = {};
}

void warn_of_views(const char* what, const std::vector<std::string>& names, StatusLine& status) {
  if (names.empty()) return;
  status.warn(detail::concat(what, names.size(), names.size() == 1 ? " view (" : " views (the first: ", names[0], ")"));
}

/// Splits the views as the training did, using cameras.json, because the held-out views may depend on which photographs
/// exist. Views that the training did not have are left out.
void split_as_trained(LoadedModel& model, StatusLine& status) {
  if (!fs::exists(model.folder.cameras())) return;
  std::map<std::string, bool> held_out;
  for (const NamedCamera& named : read_cameras_json(model.folder.cameras())) held_out[named.name] = named.held_out;
  std::array<std::vector<View>, 2> parts;  // training and test
  std::vector<std::string> added, missing;
  bool has_moved = false;
  for (const bool is_test : {false, true}) {
    for (const View& view : is_test ? model.scene.test : model.scene.train) {
      const auto known = held_out.find(view.name);
      if (known == held_out.end()) {
        added.push_back(view.name);
        continue;
      }
      has_moved = has_moved || known->second != is_test;
      parts[known->second ? 1 : 0].push_back(view);
      held_out.erase(known);
    }
  }
  if (parts[0].empty() && parts[1].empty()) return;  // all names differ
  for (std::vector<View>& part : parts) {
    if (has_moved) std::sort(part.begin(), part.end(), [](const View& a, const View& b) { return a.name < b.name; });
  }
  model.scene.train = std::move(parts[0]);
  model.scene.test = std::move(parts[1]);
  for (const auto& [name, is_held_out] : held_out) missing.push_back(name);
  warn_of_views("left out, since the training did not have them: ", added, status);
  warn_of_views("not found, but used by the training: ", missing, status);
}

/// Adds the views of the model folder's cameras.json, sorted by name. Returns false if there is none.
bool add_saved_cameras(LoadedModel& model) {
  if (model.is_file() || !fs::exists(model.folder.cameras())) return false;
  std::vector<NamedCamera> cameras = read_cameras_json(model.folder.cameras());
  std::sort(cameras.begin(), cameras.end(), [](const NamedCamera& a, const NamedCamera& b) { return a.name < b.name; });
  model.scene = Scene();
  model.scene.source_path = model.config.source_path;
  for (const NamedCamera& named : cameras) {
    std::vector<View>& part = named.held_out ? model.scene.test : model.scene.train;
    part.push_back({named.name, "", named.camera, nullptr, nullptr});
  }
  refine_poses(model);
  use_frame_of_gaussians(model);
  return true;
}

/// The differences between the views of a scene and those of the training.
struct SceneDifference {
  bool views = false;  // their number, names or poses
  bool sizes = false;  // of the images
};

SceneDifference compare_views(const std::vector<NamedCamera>& cameras, const Scene& scene) {
  // Relative to the largest coordinate and the cameras' path, because centres are products of rounded matrices.
  constexpr double kTolerance = 1e-6;
  std::map<std::string, const Camera*> trained;
  for (const NamedCamera& named : cameras) trained[named.name] = &named.camera;
  SceneDifference difference;
  difference.views = cameras.size() != scene.train.size() + scene.test.size();
  for (const std::vector<View>* views : {&scene.train, &scene.test}) {
    for (const View& view : *views) {
      const auto found = trained.find(view.name);
      if (found == trained.end()) {
        difference.views = true;
        continue;
      }
      const Camera& camera = *found->second;
      difference.sizes |= camera.width != view.camera.width || camera.height != view.camera.height;
      const std::array<double, 3> was = change_frame({}, scene.frame, camera).center(), is = view.camera.center();
      const double size = std::max({scene.extent, std::abs(was[0]), std::abs(was[1]), std::abs(was[2])});
      for (std::size_t i = 0; i < 3; ++i) difference.views |= !(std::abs(was[i] - is[i]) <= kTolerance * size);
    }
  }
  return difference;
}

}  // namespace

LoadedModel load_model(const ModelOptions& options, bool needs_views) {
  LoadedModel model = read_model(options, needs_views);
  if (!options.source_path.empty()) model.config.source_path = options.source_path;
  make_absolute(model.config.source_path);
  if (options.resolution != 0) model.config.resolution = options.resolution;
  if (options.lenses != "trained") model.config.lenses = options.lenses;
  if (options.white_background && !model.is_file() && !model.config.white_background) {
    input_error(model.folder.root().string(), ": trained without -w; omit -w, or give a copy of ",
                "the PLY outside the model folder");
  }
  model.config.white_background = model.config.white_background || options.white_background;
  model.config.device = device_name(choose_device(options.device));
  set_compute_threads(options.threads);
  use_frame_of_gaussians(model);
  StatusLine status = StatusLine::for_stderr(options.quiet);
  for (const std::string& note : model.splats.notes) status.warn(note);
  return model;
}

void add_scene(LoadedModel& model, StatusLine& status, bool with_photographs) {
  const std::string& source = model.config.source_path;
  if (!model.is_file() && !fs::exists(source)) {
    input_error("scene folder not found: ", source, "; if the scene of ", model.folder.root().string(),
                " has moved, name its folder with -s");
  }
  SceneOptions options = scene_options(model.config);
  options.load_images = with_photographs;
  options.seed_points = false;  // the model has Gaussians, so it needs no points
  options.needs_training_views = false;
  model.scene = open_scene(options, status);
  if (!model.is_file()) {
    std::string trained = model.folder.read_config().source_path;
    make_absolute(trained);
    if (trained == source) split_as_trained(model, status);
  }
  refine_poses(model);
  use_frame_of_gaussians(model);
}

std::string add_scene_or_cameras(LoadedModel& model, const ModelOptions& options, StatusLine& status) {
  try {
    add_scene(model, status);
    return "";
  } catch (const InputError& error) {
    if (!options.source_path.empty()) throw;
    status.clear();
    add_saved_cameras(model);
    return error.what();
  }
}

void add_cameras(LoadedModel& model, const ModelOptions& options, StatusLine& status) {
  if (views_are_as_trained(options) && add_saved_cameras(model)) return;
  add_scene(model, status, /*with_photographs=*/false);
}

RenderSettings image_settings(const LoadedModel& model) {
  RenderSettings settings = base_render_settings(model.config, model.splats.sh_degree);
  settings.keep_for_backward = false;
  settings.near_plane = static_cast<float>(model.near_plane);
  settings.antialiasing = settings.antialiasing || model.splats.antialiased;
  return settings;
}

ModelRenderer::ModelRenderer(const LoadedModel& model, const torch::Device& device)
    : gaussians(to_tensors(model.splats, model.splats.sh_degree, device)),
      settings(image_settings(model)),
      rasterizer(device) {}

RenderedView ModelRenderer::render(const CameraView& view) {
  return rasterizer.forward(gaussians, view, settings);
}

std::string results_variant(const LoadedModel& model, const ModelOptions& options) {
  if (views_are_as_trained(options)) return "";
  const TrainConfig trained = model.folder.read_config();
  SceneDifference difference;
  if (fs::exists(model.folder.cameras())) {
    difference = compare_views(read_cameras_json(model.folder.cameras()), model.scene);
  } else {
    difference.views = model.config.source_path != trained.source_path;
    difference.sizes = model.config.resolution != trained.resolution;
  }
  const std::string scene = scene_name(model.config.source_path);
  std::string variant = difference.views ? scene : "";
  if (difference.sizes && model.config.resolution != trained.resolution) {
    variant += detail::concat(variant.empty() ? "r" : "_r", model.config.resolution);
  } else if (difference.sizes && !difference.views) {
    variant = scene;  // same views, but photographs of another size
  }
  if (model.config.lenses != trained.lenses) variant += (variant.empty() ? "" : "_") + model.config.lenses;
  return variant;
}

std::vector<View> evenly_spaced(const std::vector<View>& views, std::size_t count) {
  if (views.size() <= count) return views;
  std::vector<View> chosen;
  for (std::size_t i = 0; i < count; ++i) chosen.push_back(views[i * views.size() / count]);
  return chosen;
}

fs::path image_folder(const LoadedModel& model, const std::string& set) {
  return model.folder.root() / set / ("ours_" + std::to_string(model.iteration));
}

std::string image_name(std::size_t index) {
  return print_to_string("%05zu.png", index);
}

int writer_threads() {
  constexpr int kMost = 16;  // each has an image: at 4K, with depth and opacity, 100 MB
  return std::min(kMost, thread_count());
}

void write_view_names(const fs::path& folder, const std::vector<View>& views) {
  nlohmann::ordered_json names = nlohmann::ordered_json::object();
  for (std::size_t i = 0; i < views.size(); ++i) names[image_name(i)] = views[i].name;
  write_file(folder / "views.json", dump_json(names, 2) + "\n");
}

}  // namespace b3dgs
