// Loads a trained model for evaluation or rendering, as selected by command-line options.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "app/common/status_line.h"
#include "config/train_config.h"
#include "core/config.h"
#include "model/formats/splat_formats.h"
#include "model/model_folder.h"
#include "raster/torch/rasterizer.h"
#include "scene/scene.h"
#include "train/scene_limits.h"

namespace b3dgs {

struct ModelOptions {
  std::string model_path;
  int iteration = -1;
  std::string source_path;
  int resolution = 0;
  std::string lenses = "trained";
  bool white_background = false;
  std::string device = "auto";
  int threads = 0;
  bool quiet = false;
};

template <class Visitor>
void visit_fields(ModelOptions& c, Visitor&& field) {
  field(Option{"model_path", 'm', {"result_dir", "model_paths"}}.common(), c.model_path, Any{}, "model folder");
  field(Option{"iteration"}, c.iteration, AtLeast{-1}, "saved iteration to load (-1 = the last)");
  field(Option{"source_path", 's', {"data_dir", "data_path"}}.common(), c.source_path, Any{},
        "COLMAP scene folder, if not the one used for training");
  field(Option{"resolution", 'r', {"data_factor"}}.common(), c.resolution, AtLeast{-1},
        "image size, as in b3dgs train (0 = as in training)");
  field(Option{"lenses"}, c.lenses, OneOf{{"trained", "undistort", "native", "auto"}},
        "photographs in their lens or undistorted, as in b3dgs train (trained: as in training)");
  field(Option{"white_background", 'w'}, c.white_background, Any{}, "white background, for a file of Gaussians");
  field(Option{"device"}.common(), c.device, OneOf{{"auto", "cpu", "cuda"}},
        "where to render; auto: on a GPU if there is one");
  field(Option{"threads"}, c.threads, AtLeast{0}, "CPU threads (0 = all cores)");
  field(Option{"quiet"}, c.quiet, Any{}, "show no progress");
}

struct LoadedModel {
  TrainConfig config;  // config of the training, with the options above applied
  ModelFolder folder{""};
  std::filesystem::path file;  // of Gaussians; empty: they are from the folder
  int iteration = 0;           // 0 if loaded from a single PLY
  SplatCloud splats;           // in the frame that the reader chose: the world's, unless it is far away
  double near_plane = 0;       // --near_plane of the config, in units of that frame
  Scene scene;                 // its views are in the frame of the Gaussians; without points

  bool is_file() const { return !file.empty(); }
};

/// Loads the Gaussians and the config of a model folder or of a file of Gaussians (model/formats/splat_formats.h),
/// without a scene. The PLY of a model folder represents its folder and iteration if no scene is named. @throws
/// InputError, with `needs_views` also if a file comes without a scene for its views
LoadedModel load_model(const ModelOptions& options, bool needs_views = false);

/// Adds the scene that the config names, and the poses that the model was trained with. @throws InputError
void add_scene(LoadedModel& model, StatusLine& status, bool with_photographs = true);

/// Does the same, but adds cameras from the folder's cameras.json if the training's scene is missing. Returns why there
/// are no photographs, or "". @throws InputError if the options name a scene that cannot be read
std::string add_scene_or_cameras(LoadedModel& model, const ModelOptions& options, StatusLine& status);

/// Adds views without photographs: those of cameras.json, or those of the scene if the options name a scene, a
/// resolution or lenses. @throws InputError as add_scene()
void add_cameras(LoadedModel& model, const ModelOptions& options, StatusLine& status);

/// Returns settings to render images of a model on the device of its config, without data for a backward pass.
RenderSettings image_settings(const LoadedModel& model);

/// A model on the device that renders it.
struct ModelRenderer {
  ModelRenderer(const LoadedModel& model, const torch::Device& device);

  /// The result is valid until the next call.
  RenderedView render(const CameraView& view);

  GaussianTensors gaussians;
  RenderSettings settings;
  Rasterizer rasterizer;
};

/// Returns a suffix for ModelFolder::results_key(). It is empty if views, image sizes and lenses are those of the
/// training, even if the scene folder has moved. Otherwise it has the scene's name, "r4" for another resolution,
/// "undistort" for other lenses, or several of these.
std::string results_variant(const LoadedModel& model, const ModelOptions& options);

/// Returns at most `count` of the views, evenly spaced, in their order.
std::vector<View> evenly_spaced(const std::vector<View>& views, std::size_t count);

/// Returns the folder for images of a split or camera path, named as in the original 3DGS: MODEL/test/ours_7000.
std::filesystem::path image_folder(const LoadedModel& model, const std::string& set);

/// "00012.png"
std::string image_name(std::size_t index);

/// Number of threads that write images while the next ones are rendered, and limit of images that wait for a thread.
int writer_threads();
inline constexpr std::size_t kFramesAhead = 2;

/// Writes views.json to a folder of such images: an object from image name to the name of the view. @throws IoError
void write_view_names(const std::filesystem::path& folder, const std::vector<View>& views);

}  // namespace b3dgs
