// What the benchmark renders: Gaussians and a camera, made up or from files.
#pragma once

#include <string>

#include "core/config.h"
#include "model/formats/splat_cloud.h"
#include "raster/args.h"

namespace b3dgs {

/// How every benchmark measures.
struct BenchRun {
  int width = 960, height = 540;        // px
  int tile_width = 0, tile_height = 0;  // px; 0: take_defaults()
  std::string culling = "ellipse";
  std::int64_t seed = 0;
  int repeat = 7;
  std::string device = "auto";
  int threads = 0;
  std::string json;
};

template <class Config, class Visitor>
std::enable_if_t<std::is_same_v<std::remove_const_t<Config>, BenchRun>> visit_fields(Config& c, Visitor&& field) {
  field(Option{"width"}, c.width, InRange{1, 16384}, "of made-up scenes: image width, px");
  field(Option{"height"}, c.height, InRange{1, 16384}, "of made-up scenes: image height, px");
  field(Option{"tile_width"}, c.tile_width, InRange{0, 32}, "px; 0: that of train's --tile auto on this device");
  field(Option{"tile_height"}, c.tile_height, InRange{0, 32}, "px; 0: that of train's --tile auto on this device");
  field(Option{"culling"}, c.culling, OneOf{{"ellipse", "square"}},
        "tiles of a Gaussian: exact, or the 3-sigma square");
  field(Option{"seed"}, c.seed, AtLeast{0}, "of made-up scenes");
  field(Option{"repeat"}, c.repeat, InRange{1, 1000}, "timed runs after one warm-up; the median is shown");
  field(Option{"device"}, c.device, OneOf{{"auto", "cpu", "cuda"}}, "what to time; auto takes a GPU if there is one");
  field(Option{"threads"}, c.threads, AtLeast{0}, "CPU threads; 0: all cores");
  field(Option{"json"}, c.json, Any{}, "write all figures to this file as well");
}

/// The fields that a benchmark's config inherits.
template <class Config, class Visitor>
void visit_run_fields(Config& c, Visitor&& field) {
  visit_fields(static_cast<std::conditional_t<std::is_const_v<Config>, const BenchRun, BenchRun>&>(c), field);
}

/// Where the options leave device and tile open, sets the device of --device auto, and the tile of training there: the
/// kernels are timed as training uses them. Every benchmark does so before it uses either.
void take_defaults(BenchRun& run);

/// What training has made of Gaussians that are spread over the image.
enum class SpreadState {
  /// Sizes, shapes and opacities of many kinds, the same everywhere. A tile is opaque after some 300 entries of its
  /// list, and a kernel stops there: a crowded tile takes it no longer than others, so skew hardly shows on a GPU.
  kTrained,
  /// Round, of opacity 0.1, and the smaller the denser they lie, as training makes them from points of a surface. A
  /// crowded tile takes thousands of them before it is opaque and keeps its block busy long after the others, as those
  /// at the horizon of `street` do.
  kFirstIteration,
};

/// Gaussians spread over the image by one law.
struct SpreadConfig {
  std::int64_t points = 1500000;
  /// Outside a small core, density falls with the distance from the image's centre (the larger of |x| and |y|, each in
  /// half images) to the power of -2 skew. 0: even; 1: as a road's points crowd at the horizon, where each doubling of
  /// the distance holds as many.
  double skew = 0;
  int sh_degree = 3;
  SpreadState state = SpreadState::kTrained;  // that of the scene `balanced`
};

struct BenchConfig : BenchRun {
  std::string scene = "street";
  std::string ply;
  std::string cameras;
  std::string view;
  std::string images = "images";
  std::int64_t points = SpreadConfig().points;
  double skew = 0;
};

template <class Config, class Visitor>
std::enable_if_t<std::is_same_v<std::remove_const_t<Config>, BenchConfig>> visit_fields(Config& c, Visitor&& field) {
  field(Option{"scene"}, c.scene, Any{},
        "street (LiDAR-like points along a road as training starts from them, a load that is uneven on purpose), "
        "balanced (Gaussians spread over the image, evenly or by --skew), a "
        "COLMAP folder (its points as training starts from them), or a model folder (its last PLY)");
  field(Option{"ply"}, c.ply, Any{}, "Gaussians of this PLY instead of the folder's");
  field(Option{"cameras"}, c.cameras, Any{}, "camera from this cameras.json instead of the folder's");
  field(Option{"view"}, c.view, Any{}, "the camera of this image; without it the first");
  field(Option{"images", 'i'}, c.images, Any{}, "of a COLMAP folder: its image folder");
  field(Option{"points"}, c.points, AtLeast{1}, "of street and balanced: number of Gaussians");
  field(Option{"skew"}, c.skew, InRange{0, 2},
        "of balanced: density falls as distance from the image's centre to the power -2 skew; 0 is even, 1 crowds as "
        "street does");
  visit_run_fields(c, field);
}

struct BenchScene {
  std::string name;
  SplatCloud cloud;
  PinholeView view{};

  GaussianArrays arrays() const;
};

/// @throws InputError if a folder or file cannot be used.
BenchScene make_bench_scene(const BenchConfig& config);

/// Trained Gaussians are the scene `balanced`: log-normal sizes of about 1.7 px, mixed opacities and shapes. Skew
/// changes where they are, and nothing else about them. Those of a first iteration have the size that their neighbours
/// would give them on the screen: 0.729 / sqrt(density there, 1/px^2), in px.
BenchScene make_spread_scene(const SpreadConfig& spread, const BenchRun& run);

}  // namespace b3dgs
