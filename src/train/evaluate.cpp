#include "train/evaluate.h"

#include "core/check.h"
#include "train/images/image_reader.h"

namespace b3dgs {

RenderSettings base_render_settings(const TrainConfig& config, int sh_degree) {
  RenderSettings settings;
  settings.background = config.white_background ? Vec3f{1, 1, 1} : Vec3f{0, 0, 0};
  settings.sh_degree = sh_degree;
  settings.near_plane = static_cast<float>(config.near_plane);
  settings.antialiasing = config.antialiasing;
  settings.culling = config.culling;
  settings.kernel = chooses_kernel(config) ? kStandardKernel : kernel_named(config.kernel);
  settings.deterministic = config.deterministic;
  settings.depth_gradient = false;  // only --depths needs it (step_settings())
  return settings;
}

ColorEvaluation color_evaluation(const TrainConfig& config) {
  return {{}, config.train_test_exp, config.exposure || config.bilateral_grid || config.train_test_exp};
}

namespace {

/// Compares one view, and replaces the colours of `rendered` by the transformed ones.
std::optional<ImageQuality> compare_view(const View& view, const Image8& truth, const ColorEvaluation& colors,
                                         RenderedView& rendered, const LpipsNetwork* lpips) {
  const torch::Tensor raw = rendered.color;
  const Image8* valid = view.valid.get();
  Image8 right;
  if (const auto known = colors.exposures.find(view.name); known != colors.exposures.end()) {
    rendered.color = transform_colors(raw, known->second);
  } else if (colors.fit_left_half) {
    const int half = truth.width / 2;
    const Image8 left = valid_in_columns(truth.width, truth.height, valid, 0, half);
    right = valid_in_columns(truth.width, truth.height, valid, half, truth.width);
    rendered.color = transform_colors(raw, fit_colors(raw, truth, &left));
    valid = &right;
  }
  std::optional<ImageQuality> quality = image_quality(rendered.color, truth, valid);
  if (!quality) return quality;
  if (colors.corrected_psnr) {
    quality->corrected_psnr = image_quality(transform_colors(raw, fit_colors(raw, truth, valid)), truth, valid)->psnr;
  }
  if (lpips != nullptr) quality->lpips = lpips->distance(rendered.color, truth, valid);
  return quality;
}

void add_to_mean(const std::optional<double>& value, std::size_t n_views, std::optional<double>& mean) {
  if (value) mean = mean.value_or(0) + *value / static_cast<double>(n_views);
}

}  // namespace

Evaluation evaluate_views(const RenderFn& render, torch::Device device, const std::vector<View>& views,
                          const RenderedFn& on_rendered, const LpipsNetwork* lpips, const ColorEvaluation& colors) {
  Evaluation evaluation;
  if (lpips != nullptr) evaluation.lpips_network = lpips->name();
  evaluation.fits_left_half = colors.fit_left_half;
  std::vector<std::shared_ptr<const ViewImage>> images;
  for (const View& view : views) {
    B3DGS_CHECK(view.image, "view ", view.name, " has no photograph to compare with");
    images.push_back(view.image);
  }
  const ReadingLoad load = device.is_cpu() ? ReadingLoad::kCpuTraining : ReadingLoad::kNothing;
  read_in_order(images, reading_threads(load), [&](std::size_t i, const std::uint8_t* rgb) {
    const View& view = views[i];
    Image8 truth(view.camera.width, view.camera.height, 3);
    truth.pixels.assign(rgb, rgb + view.image->n_bytes());
    RenderedView rendered = render(to_camera_view(view.camera));
    const std::optional<ImageQuality> quality = compare_view(view, truth, colors, rendered, lpips);
    if (quality) {
      evaluation.views.push_back({view.name, *quality});
    } else {
      evaluation.unmeasured.push_back(view.name);
    }
    if (on_rendered) on_rendered(i, view, rendered, quality);
  });
  const std::size_t n = evaluation.views.size();
  for (const auto& [name, quality] : evaluation.views) {
    evaluation.mean.psnr += quality.psnr / static_cast<double>(n);
    evaluation.mean.ssim += quality.ssim / static_cast<double>(n);
    evaluation.mean.sharpness += quality.sharpness / static_cast<double>(n);
    add_to_mean(quality.corrected_psnr, n, evaluation.mean.corrected_psnr);
    add_to_mean(quality.lpips, n, evaluation.mean.lpips);
  }
  return evaluation;
}

}  // namespace b3dgs
