// Scenes whose photographs have their own gains and tints, and gradients of appearance models.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <memory>
#include <vector>

#include "core/random.h"
#include "model/formats/splat_formats.h"
#include "scene/scene.h"
#include "scene/view_image.h"
#include "support/finite_difference.h"
#include "support/train/tiny_scene.h"
#include "train/appearance/appearance_model.h"
#include "train/evaluate.h"

namespace b3dgs::test {

/// Multiplies the channels of each training photograph by random gains, up to a factor of exp(1.5 x strength).
inline void jitter_exposures(std::vector<View>& views, double strength) {
  const RandomKey key{21, RandomStream::kExposureJitter, 0};
  for (std::size_t i = 0; i < views.size(); ++i) {
    Image8 image = *views[i].image->read();
    const auto random = random_uniform(key, i);
    for (std::size_t p = 0; p < image.pixels.size(); ++p) {
      const double gain = std::exp(strength * (2.0 * random[3] - 1 + random[p % 3] - 0.5));
      image.pixels[p] = static_cast<std::uint8_t>(std::min(255.0, std::floor(gain * image.pixels[p] + 0.5)));
    }
    views[i].image = std::make_shared<ViewImage>(std::move(image));
  }
}

/// Makes views of two sizes, with masks, gains and tints.
inline Scene make_jittered_scene() {
  TinySceneOptions options;
  options.masked = true;
  Scene scene = make_tiny_scene(options);
  options.width = 51;
  options.height = 50;
  const Scene others = make_tiny_scene(options);
  for (std::size_t i = 0; i < scene.train.size(); i += 2) scene.train[i] = others.train[i];
  jitter_exposures(scene.train, 0.2);
  return scene;
}

/// Returns the mean PSNR of a PLY, with the colours of each render fitted to its photograph.
inline double corrected_psnr(const std::filesystem::path& ply, const TrainConfig& config,
                             const std::vector<View>& views) {
  const SplatCloud cloud = read_splat_ply(ply);
  Rasterizer rasterizer(torch::kCPU);
  ColorEvaluation colors;
  colors.corrected_psnr = true;
  return evaluate_views(rasterizer, to_tensors(cloud, cloud.sh_degree, torch::kCPU), views,
                        base_render_settings(config, cloud.sh_degree), {}, nullptr, colors)
      .mean.corrected_psnr.value();
}

inline std::vector<double> to_doubles(const torch::Tensor& tensor) {
  const torch::Tensor flat = tensor.to(torch::kCPU, torch::kFloat64).contiguous();
  return {flat.data_ptr<double>(), flat.data_ptr<double>() + flat.numel()};
}

inline torch::Tensor like(const std::vector<double>& values, const torch::Tensor& tensor) {
  return torch::tensor(values, torch::kFloat64).view(tensor.sizes());
}

}  // namespace b3dgs::test
