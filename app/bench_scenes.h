// What the benchmark renders: a model, a camera and the degree of its colours.
#pragma once

#include <string>

#include "config.h"
#include "raster/args.h"
#include "scene/splat_cloud.h"

namespace b3dgs {

struct BenchConfig {
  std::string scene = "street";
  std::string ply;
  std::string images = "images";
  std::int64_t points = 1500000;
  int width = 960, height = 540;          // px
  int tile_width = 16, tile_height = 16;  // px
  std::string culling = "ellipse";
  std::int64_t seed = 0;
  int repeat = 7;
  std::string device = "cpu";
  int threads = 0;
  std::string json;
};

template <class Config, class Visitor>
std::enable_if_t<std::is_same_v<std::remove_const_t<Config>, BenchConfig>> visit_fields(Config& c, Visitor&& field) {
  field(Option{"scene"}, c.scene, Any{},
        "street (a road in its first iteration), balanced (Gaussians spread evenly over the image), or a COLMAP "
        "folder: its "
        "points as training starts from them, seen by its first view");
  field(Option{"ply"}, c.ply, Any{}, "with a COLMAP folder: Gaussians of this PLY instead of the points");
  field(Option{"images", 'i'}, c.images, Any{}, "with a COLMAP folder: its image folder");
  field(Option{"points"}, c.points, AtLeast{1}, "of street and balanced: number of Gaussians");
  field(Option{"width"}, c.width, InRange{1, 16384}, "of street and balanced: image width, px");
  field(Option{"height"}, c.height, InRange{1, 16384}, "of street and balanced: image height, px");
  field(Option{"tile_width"}, c.tile_width, InRange{1, 32}, "px");
  field(Option{"tile_height"}, c.tile_height, InRange{1, 32}, "px");
  field(Option{"culling"}, c.culling, OneOf{{"ellipse", "square"}},
        "tiles of a Gaussian: exact, or the 3-sigma square");
  field(Option{"seed"}, c.seed, AtLeast{0}, "of street and balanced");
  field(Option{"repeat"}, c.repeat, InRange{1, 1000}, "timed runs after one warm-up; the median is shown");
  field(Option{"device"}, c.device, OneOf{{"cpu", "cuda"}}, "what to time");
  field(Option{"threads"}, c.threads, AtLeast{0}, "CPU threads; 0: all cores");
  field(Option{"json"}, c.json, Any{}, "write all figures to this file as well");
}

struct BenchScene {
  std::string name;
  SplatCloud cloud;
  PinholeView view{};

  GaussianArrays arrays() const;
};

/// @throws InputError if a folder or file cannot be used.
BenchScene make_bench_scene(const BenchConfig& config);

}  // namespace b3dgs
