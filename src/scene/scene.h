// A scene ready to train on: views with pinhole cameras and 8-bit images, points, extent, split.
#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "scene/cameras/camera.h"
#include "scene/images/image.h"
#include "scene/point_cloud.h"

namespace b3dgs {

class ViewImage;

/// One registered photograph. The camera is a pinhole of exactly the image's size: distortion and scaling are undone.
struct View {
  std::string name;  // as in COLMAP's images file, sub-folders included
  std::string file;  // the photograph; empty: the image comes from no file
  Camera camera;
  std::shared_ptr<ViewImage> image;     // null if images were not asked for
  std::shared_ptr<const Image8> valid;  // one channel, 255 where the image is valid, 0 elsewhere; null: all valid
};

inline constexpr int kTestEvery = 8;  // what the published numbers of the field hold out

struct SceneOptions {
  std::string source_path;
  std::string images = "images";  // folder of the images below source_path
  int resolution = -1;            // 1, 2, 4, 8 divide; -1 caps the width at 1600 px; 32 and more: target width in px
  bool eval = false;              // hold out every 8th view by sorted name
  bool white_background = false;  // what RGBA images are composited on
  bool load_images = true;        // false: cameras and points only
  double host_memory_gb = -1;     // for decoded images, 10^9 bytes; -1: 80 % of what is available
  int n_readers = 2;              // trainings and evaluations that read images ahead at the same time
};

struct Scene {
  std::string source_path;
  std::vector<View> train;  // sorted by name
  std::vector<View> test;   // sorted by name
  PointCloud points;
  double extent = 0;                  // world units: 1.1 x largest distance of a training camera from their mean
  std::vector<std::string> summary;   // about a dozen lines that say what was loaded
  std::vector<std::string> warnings;  // what is missing of the scene, a line each
};

/// What load_scene is doing now: stage, items done, items in all. Called from one thread at a time.
using ProgressFn = std::function<void(const std::string& stage, std::size_t done, std::size_t total)>;

/// Reads a COLMAP scene. Of the images only the headers are read: ViewImage decodes. Notices that are no errors
/// (several models, a missing images folder replaced by downscaling, images missing on disk) are in `summary`.
/// @throws InputError with file, place, expected, found and remedy if the scene cannot be used.
Scene load_scene(const SceneOptions& options, const ProgressFn& progress = {});

/// 1.1 x the largest distance of a camera centre from the mean of the centres (world units); 1 if that is 0.
double scene_extent(const std::vector<View>& views);

/// "bonsai" of "/data/bonsai/".
std::string scene_name(const std::string& source_path);

}  // namespace b3dgs
