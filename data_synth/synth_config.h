// What a synthetic scene can be told.
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
  double skew = 1;
  std::string truth = "surfaces";
};

template <class Config, class Visitor>
std::enable_if_t<std::is_same_v<std::remove_const_t<Config>, SynthConfig>> visit_fields(Config& c, Visitor&& field) {
  field(
      Option{"scene"}, c.scene, OneOf{{"orbit", "street"}},
      "orbit: coloured solids on a ground, cameras around them; street: a LiDAR cloud along a road, a camera driving");
  field(Option{"output"}, c.output, Any{}, "folder to write the scene to");
  field(Option{"format"}, c.format, OneOf{{"binary", "text"}}, "form of the COLMAP model");
  field(Option{"image_format"}, c.image_format, OneOf{{"png", "jpg"}},
        "of the images: png is exact, jpg is what cameras write and decodes faster");
  field(Option{"seed"}, c.seed, AtLeast{0}, "of everything random");
  field(Option{"points"}, c.points, AtLeast{0},
        "Gaussians of orbit, LiDAR points of street; 0: 12000 for orbit, 200000 for street");
  field(Option{"views"}, c.views, AtLeast{0}, "images; 0: 40 for orbit, 24 for street");
  field(Option{"width"}, c.width, InRange{0, 16384}, "of the images, px; 0: 320 for orbit, 960 for street");
  field(Option{"height"}, c.height, InRange{0, 16384}, "of the images, px; 0: 240 for orbit, 540 for street");
  field(Option{"sh_degree"}, c.sh_degree, InRange{0, 3}, "of orbit's Gaussians; from 1 on, some of the solids shine");
  field(Option{"skew"}, c.skew, Above{0},
        "of street: 1 draws depths log-uniformly; above 1 crowds them towards the horizon, below 1 towards the camera");
  field(Option{"truth"}, c.truth, OneOf{{"surfaces", "points"}},
        "of street, what the images show: surfaces made of other Gaussians than training starts from, or the points "
        "themselves, so that their places, sizes and colours are right from the start");
}

/// The config with the scene's own numbers in place of zeros.
SynthConfig with_scene_defaults(SynthConfig config);

}  // namespace b3dgs
