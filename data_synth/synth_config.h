// Options of synthetic scenes.
#pragma once

#include <cstdint>
#include <string>

#include "core/config.h"

namespace b3dgs {

struct SynthConfig {
  std::string scene = "orbit";
  std::string output;
  std::string format = "binary";
  std::string image_format = "png";
  std::int64_t seed = 0;
  int points = 0;
  int views = 0;
  int width = 0, height = 0;  // px
  int sh_degree = 3;
  double exposure_jitter = 0;
  double skew = 1;
  std::string truth = "surfaces";
  std::string lens = "PINHOLE";
  double fov = 0;  // degrees
};

template <class Visitor>
void visit_fields(SynthConfig& c, Visitor&& field) {
  field(Option{"scene"}, c.scene, OneOf{{"orbit", "street"}},
        "orbit: solids on a plane, cameras around; street: LiDAR points, driving camera");
  field(Option{"output"}, c.output, Any{}, "output folder");
  field(Option{"format"}, c.format, OneOf{{"binary", "text"}}, "format of the COLMAP model");
  field(Option{"image_format"}, c.image_format, OneOf{{"png", "jpg"}},
        "image format; png is lossless, jpg decodes faster");
  field(Option{"seed"}, c.seed, AtLeast{0}, "random seed");
  field(Option{"points"}, c.points, AtLeast{0}, "Gaussians of orbit or LiDAR points of street (0 = 12000 or 200000)");
  field(Option{"views"}, c.views, AtLeast{0}, "number of images (0 = 40 for orbit, 24 for street)");
  field(Option{"width"}, c.width, InRange{0, 16384}, "image width, px (0 = 320 for orbit, 960 for street)");
  field(Option{"height"}, c.height, InRange{0, 16384}, "image height, px (0 = 240 for orbit, 540 for street)");
  field(Option{"sh_degree"}, c.sh_degree, InRange{0, 3},
        "SH degree of orbit's Gaussians; if above 0, some of the solids are glossy");
  field(Option{"exposure_jitter"}, c.exposure_jitter, InRange{0, 2},
        "give each image a random gain and tint, up to a factor of exp(X) and exp(X / 2)");
  field(Option{"skew"}, c.skew, Above{0},
        "depths in street; 1: log-uniform, > 1: more points far away, < 1: more nearby");
  field(Option{"truth"}, c.truth, OneOf{{"surfaces", "points"}},
        "render street from other Gaussians on its surfaces, or from the points");
  field(Option{"lens"}, c.lens, OneOf{{"PINHOLE", "OPENCV", "OPENCV_FISHEYE", "THIN_PRISM_FISHEYE", "EQUIRECTANGULAR"}},
        "lens of the images, as COLMAP names it");
  field(Option{"fov"}, c.fov, InRange{0, 340}, "degrees across the width of the images (0 = that of the scene)");
}

/// Returns the config with zeros replaced by the defaults of the scene.
SynthConfig with_scene_defaults(SynthConfig config);

}  // namespace b3dgs
