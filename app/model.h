// A trained model, loaded for measuring or rendering, and the options that choose it.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "app/terminal/progress.h"
#include "core/config.h"
#include "model/formats/splat_cloud.h"
#include "model/model_folder.h"
#include "raster/torch/rasterizer.h"
#include "scene/scene.h"
#include "train/config/train_config.h"

namespace b3dgs {

struct ModelOptions {
  std::string model_path;
  int iteration = -1;
  std::string source_path;
  int resolution = 0;
  std::string device = "auto";
  int threads = 0;
  bool quiet = false;
};

template <class Config, class Visitor>
std::enable_if_t<std::is_same_v<std::remove_const_t<Config>, ModelOptions>> visit_fields(Config& c, Visitor&& field) {
  field(Option{"model_path", 'm', {"result_dir"}}, c.model_path, Any{}, "folder of the trained model");
  field(Option{"iteration"}, c.iteration, AtLeast{-1}, "which of the saved iterations; -1: the last");
  field(Option{"source_path", 's', {"data_dir", "data_path"}}, c.source_path, Any{},
        "folder of the COLMAP scene, if it is no longer where the model was trained");
  field(Option{"resolution", 'r', {"data_factor"}}, c.resolution, AtLeast{-1},
        "as for train; 0: as the model was trained");
  field(Option{"device", '\0', {"data_device"}}, c.device, OneOf{{"auto", "cpu", "cuda"}},
        "where to render; auto takes a GPU if there is one");
  field(Option{"threads"}, c.threads, AtLeast{0}, "CPU threads; 0: all cores");
  field(Option{"quiet"}, c.quiet, Any{}, "show no progress");
}

struct LoadedModel {
  TrainConfig config;  // that the model was trained with, options above applied
  ModelFolder folder{""};
  int iteration = 0;  // 0 if it came from a single PLY
  SplatCloud splats;
  Scene scene;
};

/// Reads the folder's config and PLY and loads the scene with its photographs. @throws InputError
LoadedModel load_model(const ModelOptions& options, StatusLine& status);

/// As load_model(), for rendering: the views are those of the folder's cameras.json and have no photographs. With
/// another scene or resolution in the options, they are the scene's.
LoadedModel load_model_cameras(const ModelOptions& options, StatusLine& status);

/// Reads a PLY and the views of the scene that `options.source_path` names, without photographs. @throws InputError
LoadedModel load_ply_model(const std::filesystem::path& ply, const ModelOptions& options, StatusLine& status);

/// load_scene() with its progress and warnings.
Scene open_scene(const SceneOptions& options, StatusLine& status);

SceneOptions scene_options(const TrainConfig& config);

/// How images of a model are rendered on the device of its config: nothing is kept for a backward pass.
RenderSettings image_settings(const LoadedModel& model);

/// For results of a model's loaded scene (ModelFolder::results_key): "" where views and sizes are those it was trained
/// with, wherever the scene lies now; else the scene's name, "r4" for another resolution, or both.
std::string results_variant(const LoadedModel& model, const ModelOptions& options);

/// Folder for images of a split or path, as the original 3DGS names it: MODEL/test/ours_7000.
std::filesystem::path image_folder(const LoadedModel& model, const std::string& set);

/// "00012.png"
std::string image_name(std::size_t index);

}  // namespace b3dgs
