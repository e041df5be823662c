// Scenes for benchmarks: Gaussians and a camera, synthetic or from files.
#pragma once

#include <string>

#include "config/choices.h"
#include "core/config.h"
#include "model/formats/splat_formats.h"
#include "raster/args.h"

namespace b3dgs {

/// Options of all benchmarks of one view.
struct BenchRun {
  int width = 960, height = 540;  // px
  Culling culling = Culling::kEllipse;
  std::int64_t seed = 0;
  int repeat = 7;
  std::string device = "auto";
  int threads = 0;
  std::string json;
};

template <class Visitor>
void visit_fields(BenchRun& c, Visitor&& field) {
  field(Option{"width"}, c.width, InRange{1, 16384}, "image width of synthetic scenes, px");
  field(Option{"height"}, c.height, InRange{1, 16384}, "image height of synthetic scenes, px");
  field(Option{"culling"}, c.culling, one_of<Culling>(),
        "how to decide which tiles a Gaussian touches; square: 3-sigma box, as in 3DGS");
  field(Option{"seed"}, c.seed, AtLeast{0}, "random seed of synthetic scenes");
  field(Option{"repeat"}, c.repeat, InRange{1, 1000}, "timed repetitions after one warm-up; the median is shown");
  field(Option{"device"}, c.device, OneOf{{"auto", "cpu", "cuda"}}, "what to time; auto: a GPU if there is one");
  field(Option{"threads"}, c.threads, AtLeast{0}, "CPU threads (0 = all cores)");
  field(Option{"json"}, c.json, Any{}, "also write all numbers to this new file");
}

/// The training stage that synthetic Gaussians imitate.
enum class SpreadState {
  /// The scene `spread`: log-normal sizes of about 1.7 px, varied opacities and shapes. About 300 Gaussians make a tile
  /// opaque, where kernels stop, so skew has little effect on a GPU.
  kTrained,
  /// Spherical, with opacity 0.1 and sizes of 0.729 / sqrt(density in 1/px^2) px, as training initializes them from
  /// points on a surface. A crowded tile needs thousands of Gaussians to become opaque, so its thread block runs long
  /// after the others, as in `street`.
  kFirstIteration,
};

/// Distribution of synthetic Gaussians over the image.
struct SpreadConfig {
  std::int64_t points = 1500000;
  /// Outside a small core, the density is proportional to distance^(-2 skew), where distance is max(|x|, |y|) from the
  /// image centre in units of half the image size. 0 is even, and 1 is like points of a road near the horizon.
  double skew = 0;
  int sh_degree = 3;
  SpreadState state = SpreadState::kTrained;
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

template <class Visitor>
void visit_fields(BenchConfig& c, Visitor&& field) {
  field(Option{"scene"}, c.scene, Any{}, "street (uneven load), spread (see --skew), COLMAP folder or model folder");
  field(Option{"ply"}, c.ply, Any{}, "load the Gaussians from this file (PLY or SPZ) instead");
  field(Option{"cameras"}, c.cameras, Any{}, "load the camera from this cameras.json instead");
  field(Option{"view"}, c.view, Any{}, "use the camera of this image (default: the first)");
  field(Option{"images", 'i'}, c.images, Any{}, "image folder inside the COLMAP folder");
  field(Option{"points"}, c.points, AtLeast{1}, "number of Gaussians of street and spread");
  field(Option{"skew"}, c.skew, InRange{0, 2},
        "density of spread ~ (distance from image centre)^(-2 X); 0: even, 1: like street");
  visit_fields(static_cast<BenchRun&>(c), field);
}

struct BenchScene {
  std::string name;
  SplatCloud cloud;
  CameraView view{};
};

/// @throws InputError if a folder or file is missing or invalid
BenchScene make_bench_scene(const BenchConfig& config);

/// Makes synthetic Gaussians in front of one camera.
BenchScene make_spread_scene(const SpreadConfig& spread, const BenchRun& run);

}  // namespace b3dgs
