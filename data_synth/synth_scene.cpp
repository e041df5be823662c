#include "data_synth/synth_scene.h"

#include <algorithm>
#include <cmath>

#include "model/raster_input.h"
#include "raster/cpu/passes.h"
#include "raster/math/sh.h"

namespace b3dgs {

SynthConfig with_scene_defaults(SynthConfig config) {
  const bool is_street = config.scene == "street";
  if (config.points == 0) config.points = is_street ? 200000 : 12000;
  if (config.views == 0) config.views = is_street ? 24 : 40;
  if (config.width == 0) config.width = is_street ? 960 : 320;
  if (config.height == 0) config.height = is_street ? 540 : 240;
  return config;
}

SynthScene make_scene(const SynthConfig& config) {
  return config.scene == "street" ? make_street(config) : make_orbit(config);
}

Image8 render_truth(const SplatCloud& truth, const Camera& camera) {
  RenderSettings settings;
  settings.sh_degree = truth.sh_degree;

  const std::size_t n_pixels = static_cast<std::size_t>(camera.width) * camera.height;
  std::vector<float> color(3 * n_pixels), depth(n_pixels), alpha(n_pixels);
  cpu::make_rasterizer()->forward(to_gaussian_arrays(truth), to_camera_view(camera), settings,
                                  {color.data(), depth.data(), alpha.data()});

  Image8 image(camera.width, camera.height, 3);
  std::transform(color.begin(), color.end(), image.pixels.begin(), [](float value) {
    return static_cast<std::uint8_t>(std::lround(255.0f * std::clamp(value, 0.0f, 1.0f)));
  });
  return image;
}

float sh0_from_color(double color) {
  return static_cast<float>((color - 0.5) / kSh0);
}
double color_from_sh0(float coefficient) {
  return 0.5 + kSh0 * coefficient;
}

}  // namespace b3dgs
