#include "train/final_config.h"

#include <utility>

#include "core/check.h"
#include "core/config.h"
#include "raster/kernels.h"
#include "scene/crop_region.h"
#include "train/device.h"
#include "train/evaluate.h"
#include "train/gaussians/gaussian_model.h"
#include "train/scene_limits.h"

namespace b3dgs {

void check_options(const TrainConfig& config, torch::Device device) {
  if (config.deterministic && config.kernel == kPublishedKernel) {
    input_error(
        "--deterministic: --kernel published chooses by measured times, which differ from run to run; omit one of "
        "them");
  }
  const KernelFamily family = family_of(base_render_settings(config, 0).kernel);
  if (device.is_cuda() && config.deterministic && family == KernelFamily::kPaper) {
    input_error("--deterministic: on a GPU, the backward kernel of --kernel ", config.kernel,
                " sums in an order that differs from run to run; use --kernel sub-tile or segmented");
  }
  const bool grows = config.max_gaussians == 0 && config.gaussians_per_pixel == 0;
  if (config.strategy == Strategy::kMcmc && grows && device.is_cpu()) {
    input_error("--strategy mcmc --max_gaussians 0: expected a limit on a CPU, where free memory does not limit ",
                "growth; pass one, such as --max_gaussians 1000000");
  }
  if (!config.crop.empty()) parse_crop(config.crop);
  if (!config.crop.empty() && config.strategy != Strategy::kBudget) {
    input_error("--crop: expected --strategy budget, found ", name_of(config.strategy),
                ", which cannot add Gaussians mostly in a region; omit --crop, and export with it");
  }
  if (config.exposure && config.bilateral_grid) {
    input_error("--exposure and --bilateral_grid cannot be used together; the grid can represent exposures, too");
  }
  if (config.train_test_exp && !config.eval) {
    input_error("--train_test_exp: needs test views; add --eval, or omit --train_test_exp");
  }
  if (!config.init_ply.empty()) holds_splats(config.init_ply);  // reads the header
}

FinalConfig finalize(TrainConfig config, const Scene& scene) {
  check_scene_options(config, scene);
  const torch::Device device = choose_device(config.device);
  config = with_scene_limits(std::move(config), scene);
  if (!config.crop.empty()) config.crop = crop_text(parse_crop(config.crop));  // checkpoints do not need its file
  config.device = device_name(device);
  check_options(config, device);
  return {std::move(config), device};
}

}  // namespace b3dgs
