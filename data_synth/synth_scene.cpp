#include "data_synth/synth_scene.h"

#include <algorithm>
#include <cmath>

#include "core/check.h"
#include "core/vec.h"
#include "model/raster_input.h"
#include "raster/cpu/passes.h"
#include "raster/math/sh.h"
#include "scene/cameras/camera_lens.h"

namespace b3dgs {
namespace {

Image8 render_through_lens(const SplatCloud& truth, const Camera& camera);

}  // namespace

SynthConfig with_scene_defaults(SynthConfig config) {
  const bool is_street = config.scene == "street";
  if (config.points == 0) config.points = is_street ? 200000 : 12000;
  if (config.views == 0) config.views = is_street ? 24 : 40;
  if (config.width == 0) config.width = is_street ? 960 : 320;
  if (config.height == 0) config.height = is_street ? 540 : 240;
  return config;
}

namespace {

/// Returns `pinhole` with the lens of the config.
Camera with_lens_of(const SynthConfig& config, const Camera& pinhole) {
  Camera camera = pinhole;
  double reach = 0.5 * pinhole.width / pinhole.fx;  // half the width, in focal lengths
  const auto set_lens = [&](LensKind kind, std::initializer_list<double> coefficients) {
    camera.lens.kind = kind;
    std::copy(coefficients.begin(), coefficients.end(), camera.lens.k);
  };
  if (config.lens == "EQUIRECTANGULAR") {
    if (pinhole.width != 2 * pinhole.height) {
      input_error("--lens EQUIRECTANGULAR: expected images twice as wide as high, found ", pinhole.width, " x ",
                  pinhole.height, "; name a --width of twice the --height");
    }
    camera = panorama_camera({pinhole.width, pinhole.height});
    camera.cam_from_world = pinhole.cam_from_world;
    return camera;
  }
  if (config.lens == "PINHOLE" || config.lens == "OPENCV") {
    if (config.fov >= 160)
      input_error("--fov: expected below 160 degrees for --lens ", config.lens, ", found ", config.fov);
    if (config.fov > 0) reach = std::tan(config.fov * kPi / 360);
    if (config.lens == "OPENCV") {
      set_lens(LensKind::kDistorted, {-0.08, 0.01, 0, 0, 0, 0, 0, 0.002, -0.003});
      if (config.fov > 0) reach = distort(camera.lens, reach, 0)[0];
    }
  } else {
    const bool is_prism = config.lens == "THIN_PRISM_FISHEYE";
    set_lens(LensKind::kFisheye, {0.02, -0.004, 0.0005, -0.00002});
    if (is_prism) set_lens(LensKind::kFisheye, {0.02, -0.004, 0.0005, -0.00002, 0, 0, 0, 0.002, -0.003, 0.001, -0.002});
    const double angle = (config.fov > 0 ? config.fov : 180) * kPi / 360, s = angle * angle;
    reach = angle * (1 + s * (0.02 + s * (-0.004 + s * (0.0005 - s * 0.00002))));
  }
  camera.fx = camera.fy = 0.5 * pinhole.width / reach;
  return native_camera(camera, "--lens " + config.lens);
}

}  // namespace

SynthScene make_scene(const SynthConfig& config) {
  SynthScene scene = config.scene == "street" ? make_street(config) : make_orbit(config);
  if (config.lens == "PINHOLE" && config.fov == 0) return scene;
  for (Camera& camera : scene.cameras) camera = with_lens_of(config, camera);
  return scene;
}

Image8 render_truth(const SplatCloud& truth, const Camera& camera) {
  if (!camera.is_pinhole()) return render_through_lens(truth, camera);
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

namespace {

Image8 render_through_lens(const SplatCloud& truth, const Camera& camera) {
  constexpr int kFiner = 3;
  const Camera fine = camera.scaled_to(kFiner * camera.width, kFiner * camera.height);
  Image8 image(fine.width, fine.height, 3);
  for (const Camera& face : pinhole_faces(fine)) {
    const Warped warped = warp_image(render_truth(truth, face), face, fine);
    for (std::size_t i = 0; i < image.pixels.size(); ++i) {
      if (warped.valid.pixels[i / 3] != 0) image.pixels[i] = warped.image.pixels[i];
    }
  }
  return resize_image(image, camera.width, camera.height);
}

}  // namespace

float sh0_from_color(double color) {
  return static_cast<float>((color - 0.5) / kSh0);
}
double color_from_sh0(float coefficient) {
  return 0.5 + kSh0 * coefficient;
}

}  // namespace b3dgs
