// The cameras of `b3dgs render`: views of a scene or cameras from a file, or a path through or around them.
#pragma once

#include <string>
#include <vector>

#include "core/config.h"
#include "core/options/command_line.h"
#include "model/cameras/cameras_json.h"
#include "model/formats/splat_formats.h"
#include "scene/scene.h"

namespace b3dgs {

inline constexpr int kMaxRenderSide = 32768;  // px

struct CameraOptions {
  std::string path = "test";
  std::string cameras;
  int frames = 120;
  int width = 0;
  int height = 0;
  std::string projection = "auto";
  double fov = 0;
  double elevation = 0;
  double distance = 0;
  std::string up = "auto";
  ImageSize
      path_size{};  // not on the command line: used for paths without `width` and `height`; 0: that of the cameras
};

template <class Visitor>
void visit_fields(CameraOptions& c, Visitor&& field) {
  field(Option{"path"}.common(), c.path, OneOf{{"test", "train", "interpolated", "orbit", "turntable"}},
        "test or training views, a path through the training views, or around the scene");
  field(Option{"cameras"}.common(), c.cameras, Any{},
        "cameras from this file: cameras.json, camera path or transforms.json");
  field(Option{"frames"}.common(), c.frames, AtLeast{1}, "images of --path interpolated, orbit and turntable");
  field(Option{"width"}.common(), c.width, InRange{0, kMaxRenderSide},
        "image width, px (0 = that of the cameras; videos of paths: 1920 x 1080)");
  field(Option{"height"}.common(), c.height, InRange{0, kMaxRenderSide}, "image height, px (0 = that of the cameras)");
  field(Option{"projection"}, c.projection, OneOf{{"auto", "pinhole", "fisheye", "equirectangular"}},
        "of the images; auto: views in their lens, paths as a pinhole");
  field(Option{"fov"}, c.fov, InRange{0, 350},
        "vertical field of view of orbit, turntable and fisheye, degrees (0 = that of the cameras)");
  field(Option{"elevation"}, c.elevation, InRange{-89, 89},
        "of the turntable above its centre, degrees (default: that of the cameras, or 15)");
  field(Option{"distance"}, c.distance, AtLeast{0},
        "of the turntable from its centre, world units (0 = that of the cameras)");
  field(Option{"up"}, c.up, OneOf{{"auto", "x", "y", "z", "-x", "-y", "-z"}},
        "axis that orbit and turntable turn about; auto: up of the cameras, or -y");
}

/// The cameras to render, of positive size.
struct CameraChoice {
  std::vector<Camera> cameras;
  std::vector<View> views;         // one view for each camera; empty for paths and nameless cameras
  std::string set;                 // for names of folders: "test", "turntable", "cameras/FILE" without extension
  double fps = 0;                  // frames per second of the camera file; 0: not in the file
  std::vector<std::string> notes;  // for the user, one line each
};

/// Returns whether the options need the views of a scene.
bool needs_views(const CameraOptions& options);

/// @throws InputError if options contradict each other
void check_camera_options(const CommandLine& line, const CameraOptions& options);

/// Returns the selected cameras in the requested size. `line` tells which options were given. If the size changes, a
/// camera keeps its vertical field of view and its square pixels or, in CameraOptions::path_size, the field of view
/// along its longer side. @throws InputError, also for a bad camera file
CameraChoice choose_cameras(const CommandLine& line, const CameraOptions& options, const Scene& scene,
                            const SplatCloud& splats);

/// Returns the camera for an image of another size. The vertical field of view, the shape of pixels, and the distance
/// of the principal point from the centre relative to the height stay the same.
Camera fit_to_size(const Camera& camera, ImageSize size);
/// Does the same, but keeps the field of view along the longer side, which may change from one side to the other.
Camera fit_longer_side(const Camera& camera, ImageSize size);

}  // namespace b3dgs
