#include "app/bench_scenes.h"

#include <cmath>

#include "data_synth/random.h"
#include "data_synth/synth_scene.h"
#include "scene/ply.h"
#include "scene/scene.h"
#include "train/evaluate.h"
#include "train/gaussian_model.h"

namespace b3dgs {
namespace {

BenchScene make_street_bench(const BenchConfig& config) {
  SynthConfig synth;
  synth.scene = "street";
  synth.seed = config.seed;
  synth.points = static_cast<int>(config.points);
  synth.views = 1;
  synth.width = config.width;
  synth.height = config.height;
  const SynthScene street = make_scene(with_scene_defaults(synth));
  return {"street", splats_from_points(street.points, 3), to_pinhole_view(street.cameras.front())};
}

/// Gaussians spread evenly over the image, log-normal sizes of about 1.7 px, mixed opacities and shapes, SH degree 3:
/// no tile has much more to do than another.
BenchScene make_balanced_bench(const BenchConfig& config) {
  constexpr double kFocal = 1000, kNearest = 2, kDepthRange = 8, kMedianSigma = 1.7;
  Random random(config.seed);
  BenchScene scene{"balanced", {}, {}};
  SplatCloud& cloud = scene.cloud;
  cloud.sh_degree = 3;
  for (std::int64_t i = 0; i < config.points; ++i) {
    const double z = kNearest + kDepthRange * random.uniform();
    const double x = (random.uniform() - 0.5) * config.width / kFocal * z;
    const double y = (random.uniform() - 0.5) * config.height / kFocal * z;
    for (const double coordinate : {x, y, z}) cloud.means.push_back(static_cast<float>(coordinate));
    const double log_sigma = std::log(kMedianSigma * z / kFocal) + 0.5 * random.normal();
    for (int k = 0; k < 3; ++k) cloud.log_scales.push_back(static_cast<float>(log_sigma + 0.3 * random.normal()));
    for (int k = 0; k < 4; ++k) cloud.quats.push_back(static_cast<float>(random.normal()));
    cloud.logit_opacities.push_back(static_cast<float>(1.5 * random.normal()));
    for (int k = 0; k < 3; ++k) cloud.sh0.push_back(static_cast<float>(random.normal()));
    for (int k = 0; k < 45; ++k) cloud.shN.push_back(static_cast<float>(0.1 * random.normal()));
  }
  Camera camera;
  camera.width = config.width;
  camera.height = config.height;
  camera.fx = camera.fy = kFocal;
  camera.cx = 0.5 * config.width;
  camera.cy = 0.5 * config.height;
  scene.view = to_pinhole_view(camera);
  return scene;
}

BenchScene make_colmap_bench(const BenchConfig& config) {
  SceneOptions options;
  options.source_path = config.scene;
  options.images = config.images;
  options.load_images = false;
  const Scene scene = load_scene(options);
  return {config.scene, config.ply.empty() ? splats_from_points(scene.points, 3) : read_splat_ply(config.ply),
          to_pinhole_view(scene.train.front().camera)};
}

}  // namespace

GaussianArrays BenchScene::arrays() const {
  return {cloud.size(),       cloud.sh_degree,
          cloud.means.data(), cloud.log_scales.data(),
          cloud.quats.data(), cloud.logit_opacities.data(),
          cloud.sh0.data(),   cloud.shN.data()};
}

BenchScene make_bench_scene(const BenchConfig& config) {
  BenchScene scene = config.scene == "street"     ? make_street_bench(config)
                     : config.scene == "balanced" ? make_balanced_bench(config)
                                                  : make_colmap_bench(config);
  if (scene.cloud.size() == 0) input_error(config.scene, ": has no points to start from; name a model with --ply");
  return scene;
}

}  // namespace b3dgs
