// A scene to train on: views with cameras and 8-bit images, split into training and test views, and points.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "scene/cameras/camera.h"
#include "scene/cameras/coordinate_frame.h"
#include "scene/georeference.h"
#include "scene/images/image.h"
#include "scene/points/point_cloud.h"

namespace b3dgs {

class ViewImage;

/// One registered photograph. The camera has the size of the image. It is a pinhole, because lens distortion has been
/// removed, unless it keeps its lens (SceneOptions::lenses).
struct View {
  std::string name;  // as in COLMAP's images file, sub-folders included
  std::string file;  // the photograph; empty: the image is not from a file
  Camera camera;
  std::shared_ptr<ViewImage> image;     // null if SceneOptions::load_images is false
  std::shared_ptr<const Image8> valid;  // mask of one channel: 255 where valid, 0 elsewhere; null: all valid
  // With SceneOptions::empty_background: 255 where the mask of the photograph leaves a pixel out, so that it must be
  // empty. Null if no pixel is.
  std::shared_ptr<const Image8> empty{};
  std::vector<std::int32_t> points{};  // with SceneOptions::tracks: indices of Scene::points that COLMAP saw in it
  std::string mask_file{};             // the file of `valid` and `empty`; empty: there is no mask
};

inline constexpr int kTestEvery = 8;  // as in the published results of the field

struct SceneOptions {
  std::string source_path;
  std::string images = "images";  // folder of the images inside source_path
  int resolution = -1;            // 1, 2, 4, 8 divide; -1 limits the width to 1600 px; 32 or more: target width in px
  bool eval = false;              // hold out the views that the scene names, or every 8th by sorted name
  bool needs_training_views = true;  // an error if `eval` leaves no view to train on
  bool white_background = false;     // background of RGBA images
  bool tracks = false;               // read which points each view sees
  std::string masks;                 // find_mask_folder(); "": masks/ inside source_path, if there is one; "none"
  bool invert_masks = false;         // white is left out instead of black
  bool empty_background = false;     // see View::empty
  std::string lenses = "undistort";  // or "native": keep distorted lenses; "auto": where undistorting shows too little
  bool load_images = true;           // false: cameras and points only
  bool seed_points = false;          // training needs points; if there are none, add_points_of_photographs() finds some
  double host_memory_gb = -1;        // for decoded images, 10^9 bytes; -1: 80 % of the available memory
  int n_readers = 2;                 // trainings and evaluations that prefetch images at the same time
  std::optional<CoordinateFrame> frame;  // frame of a resumed training; empty: choose_frame()
};

struct Scene {
  std::string source_path;
  std::vector<View> train;  // sorted by name
  std::vector<View> test;   // sorted by name
  PointCloud points;
  std::int64_t n_added_points = 0;           // the last of them were found in the photographs, beside the scene's own
  CoordinateFrame frame;                     // of cameras, points and extent
  std::optional<SceneOptions> options;       // passed to load_scene()
  double extent = 0;                         // scene_extent() of the training views
  std::optional<Georeference> georeference;  // place on the Earth, if it is known
  std::vector<std::string> summary;          // about a dozen lines that describe the scene
  std::vector<std::string> warnings;         // one line for each missing item
};

/// Progress of load_scene(): stage, items done, total. Called from one thread at a time.
using ProgressFn = std::function<void(const std::string& stage, std::size_t done, std::size_t total)>;

/// Reads a scene of COLMAP or in transforms.json files, and moves it to its own frame (choose_frame()). Only the
/// headers of the photographs are read. ViewImage decodes them. `summary` mentions automatic choices (one of several
/// models, images reduced because images_N is missing) and missing photographs. @throws InputError with file, place,
/// expected, found and remedy if the scene cannot be used
Scene load_scene(const SceneOptions& options, const ProgressFn& progress = {});

/// Returns 1.1 x the limited_radius() of the cameras, or 1 if that is 0. Views and points ([N, 3]) are in the same
/// coordinates.
double scene_extent(const std::vector<View>& views, const std::vector<double>& points = {});

/// Moves cameras and extent of the scene to another frame, but not its points.
void change_frame_of_views(const CoordinateFrame& to, Scene& scene);

/// Returns the up direction in world coordinates, of length 1. In a scene with a place on the Earth, it is +z.
/// Otherwise, it is the up_direction() of all cameras, and nothing is returned if that returns nothing.
std::optional<std::array<double, 3>> scene_up(const Scene& scene);

/// Returns the last part of the path: "bonsai" for "/data/bonsai/".
std::string scene_name(const std::string& source_path);

}  // namespace b3dgs
