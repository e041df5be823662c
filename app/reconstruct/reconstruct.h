// Makes a COLMAP scene from photographs or a video, using the programs colmap and ffmpeg.
#pragma once

#include <atomic>
#include <cstddef>
#include <functional>
#include <optional>
#include <string>
#include <type_traits>
#include <vector>

#include "core/config.h"
#include "scene/colmap/colmap.h"
#include "scene/georeference.h"

namespace b3dgs {

struct ReconstructOptions {
  std::string input;   // a folder of photographs, or a video
  std::string output;  // scene folder
  std::string matcher = "auto";
  std::string camera_model = "OPENCV";
  std::string camera_per = "size";
  int frames = 0;  // number of frames of a video; 0: automatic
  std::string use_gpu = "auto";
  int threads = 0;  // 0: all cores
  int max_features = 8192;
  double min_registered = 0.6;
  bool georeference = true;
};

inline std::vector<std::string> supported_camera_model_names() {
  std::vector<std::string> names;
  for (const CameraModel model : supported_camera_models()) names.emplace_back(camera_model_name(model));
  return names;
}

template <class Visitor>
void visit_fields(ReconstructOptions& c, Visitor&& field) {
  field(Option{"input"}.common(), c.input, Any{}, "folder of photographs, or a video file");
  field(Option{"output"}.common(), c.output, Any{}, "scene folder, which `train` takes");
  field(Option{"frames"}.common(), c.frames, AtLeast{0},
        "of a video: number of frames to use; 0 = 2 per second, but 100 to 300");
  field(Option{"matcher"}.common(), c.matcher, OneOf{{"auto", "exhaustive", "sequential"}},
        "all pairs, or neighbours in the order of names; auto: all pairs up to 300");
  field(Option{"camera_model"}.common(), c.camera_model, OneOf{supported_camera_model_names()},
        "COLMAP's camera model; EQUIRECTANGULAR: panoramas of 360 degrees");
  field(Option{"camera_per"}.common(), c.camera_per, OneOf{{"size", "folder", "photo"}},
        "photographs of one size, of one folder, or none share a camera (lens and zoom)");
  field(Option{"use_gpu"}, c.use_gpu, OneOf{{"auto", "0", "1"}},
        "let COLMAP use a GPU; auto: if it was built with CUDA and there is a GPU");
  field(Option{"threads"}.common(), c.threads, AtLeast{0}, "threads of COLMAP; 0 = all cores; fewer need less memory");
  field(Option{"max_features"}, c.max_features, AtLeast{100}, "features that COLMAP extracts from a photograph");
  field(Option{"min_registered"}, c.min_registered, InRange{0, 1}, "least share of photographs that must get a camera");
  field(Option{"georeference"}.common(), c.georeference, Any{},
        "scene in metres, with z up, by the GPS positions of the photographs, if they agree");
}

struct ReconstructResult {
  bool is_stopped = false;        // by `stop`; finished work is kept
  std::size_t n_photographs = 0;  // number given to COLMAP
  std::size_t n_registered = 0;   // number registered in the largest model
  std::size_t n_models = 0;
  std::size_t n_points = 0;                  // of the largest model
  double mean_error = 0;                     // px, mean reprojection error of its points
  std::optional<Georeference> georeference;  // of the scene
};

/// `done` of `total` (0: unknown) of a stage, such as "matching".
using ReconstructProgress = std::function<void(const std::string& stage, std::size_t done, std::size_t total)>;

/// Makes a scene from the photographs or the video `options.input`: SCENE/images and SCENE/sparse/0. If there are
/// several models, it is the largest. COLMAP gets panoramas (camera model EQUIRECTANGULAR) as perspective images, but
/// the scene has panoramas. Work of an earlier call with the same input and options is not repeated. If `*stop` becomes
/// nonzero, the running program is ended. `warn` gets one line for each notable event, such as a photograph that is
/// left out, also if an error follows. @throws InputError if the input cannot be used, a program is missing or fails,
/// or too few photographs can be registered (the models are then kept in SCENE/reconstruct/sparse); IoError
ReconstructResult reconstruct(const ReconstructOptions& options, const ReconstructProgress& progress = {},
                              const std::atomic<int>* stop = nullptr,
                              const std::function<void(const std::string& line)>& warn = {});

}  // namespace b3dgs
