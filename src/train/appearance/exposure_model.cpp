#include <fstream>
#include <nlohmann/json.hpp>

#include "core/check.h"
#include "core/files/atomic_file.h"
#include "core/json_text.h"
#include "core/parallel.h"
#include "raster/torch/tensors.h"
#include "raster/torch/torch_cuda.h"
#include "train/appearance/appearance_model.h"
#include "train/appearance/exposure.h"
#include "train/optimizer/adam.h"

namespace b3dgs {
namespace {

namespace on_cpu {

void exposure_backward(const ExposureArgs& args) {
  parallel_pool(args.n_blocks(), [&](std::int64_t block, int) {
    double sums[kExposureSize] = {};
    const std::int64_t end = std::min((block + 1) * kExposureBlock, args.n_pixels);
    for (std::int64_t pixel = block * kExposureBlock; pixel < end; ++pixel) expose_pixel_backward(args, pixel, sums);
    std::copy_n(sums, kExposureSize, args.block_sums + block * kExposureSize);
  });
  double total[kExposureSize] = {};
  for (std::int64_t block = 0; block < args.n_blocks(); ++block) {
    for (int k = 0; k < kExposureSize; ++k) total[k] += args.block_sums[block * kExposureSize + k];
  }
  for (int k = 0; k < kExposureSize; ++k) args.transform_grad[k] = static_cast<float>(total[k]);
}

void center_exposures(const ExposureStepArgs& args) {
  for (int k = 0; k < kExposureSize; ++k) {
    double sum = 0;
    for (std::int64_t i = k; i < args.adam.n; i += kExposureSize) sum += static_cast<double>(args.adam.param[i]);
    const float excess = mean_excess(args, k, sum);
    for (std::int64_t i = k; i < args.adam.n; i += kExposureSize) args.adam.param[i] -= excess;
  }
}

}  // namespace on_cpu

}  // namespace

ExposureModel::ExposureModel(const TrainConfig& config, std::int64_t n_views, torch::Device device)
    : AppearanceModel(config, n_views, device, &AppearanceState::exposures, {3, 4}) {
  if (device.is_cpu()) all_grads_ = torch::zeros({n_views, 3, 4});
}

ExposureArgs ExposureModel::args_of(const AppearanceState& state, std::int32_t view,
                                    const torch::Tensor& rendered) const {
  TensorCheck check(rendered.device());
  check.dims("rendered", rendered, {"H", "W", 3});
  ExposureArgs args;
  args.transform = transforms_of(state, view);
  args.n_pixels = rendered.size(0) * rendered.size(1);
  args.rendered = rendered.data_ptr<float>();
  if (photograph().defined()) check.dims("photograph", photograph(), {"H", "W", 3}, torch::kUInt8);
  args.photograph = data_or_null<std::uint8_t>(photograph());
  return args;
}

torch::Tensor ExposureModel::apply(const AppearanceState& state, std::int32_t view, const torch::Tensor& rendered) {
  ExposureArgs args = args_of(state, view, rendered);
  args.corrected = make_room(rendered);
  for_rows<expose_pixel>(device_.is_cuda(), args, args.n_pixels);
  return corrected_;
}

void ExposureModel::backward(const AppearanceState& state, std::int32_t view, const torch::Tensor& rendered,
                             torch::Tensor grad) {
  B3DGS_CHECK(grad.sizes() == rendered.sizes(), "a gradient of ", grad.sizes(), " for a render of ", rendered.sizes());
  TensorCheck(rendered.device()).dims("grad", grad, {"H", "W", 3});
  ExposureArgs args = args_of(state, view, rendered);
  const std::int64_t n_sums = args.n_blocks() * kExposureSize;
  if (!block_sums_.defined() || block_sums_.numel() < n_sums) {
    block_sums_ = torch::empty({n_sums}, rendered.options().dtype(torch::kFloat64));
  }
  args.grad = grad.data_ptr<float>();
  args.block_sums = block_sums_.data_ptr<double>();
  args.transform_grad = this->grad().data_ptr<float>();
  if (kTorchHasCuda && device_.is_cuda()) return cuda::exposure_backward(args, torch_stream());
  on_cpu::exposure_backward(args);
}

void ExposureModel::step(std::int32_t view, int iteration, AppearanceState& state) {
  ++state.steps;
  ExposureStepArgs args;
  args.adam.n = state.exposures.numel();
  args.adam.param = state.exposures.data_ptr<float>();
  args.adam.m = state.m.data_ptr<float>();
  args.adam.v = state.v.data_ptr<float>();
  const double rate =
      log_linear_rate(config_.exposure_lr_init, config_.exposure_lr_final, config_.iterations, iteration);
  args.adam.size = adam_step_size(rate, state.steps);
  args.first = std::int64_t{view} * kExposureSize;
  args.transform_grad = grad().data_ptr<float>();
  if (kTorchHasCuda && device_.is_cuda()) return cuda::exposure_step(args, torch_stream());
  float* const grads = all_grads_.data_ptr<float>();
  std::copy_n(args.transform_grad, kExposureSize, grads + args.first);
  args.adam.grad = grads;
  cpu::adam_step(args.adam);
  std::fill_n(grads + args.first, kExposureSize, 0.0f);
  on_cpu::center_exposures(args);
}

using Json = nlohmann::ordered_json;

Exposures named_exposures(const torch::Tensor& exposures, const std::vector<View>& views) {
  B3DGS_CHECK(exposures.size(0) == static_cast<std::int64_t>(views.size()), exposures.size(0), " exposures of ",
              views.size(), " views");
  const torch::Tensor host = exposures.to(torch::kCPU).contiguous();
  Exposures named;
  const float* values = host.data_ptr<float>();
  for (const View& view : views) {
    ColorTransform& transform = named[view.name];
    for (auto& row : transform) {
      for (double& value : row) value = *values++;
    }
  }
  return named;
}

void write_exposures(const std::filesystem::path& path, const Exposures& exposures) {
  write_file(path, Json(exposures).dump(2, ' ', false, Json::error_handler_t::replace) + "\n");
}

Exposures read_exposures(const std::filesystem::path& path) {
  std::ifstream file(path);
  if (!file) input_error(path.string(), ": cannot be opened");
  const Json json = parse_json(file);
  if (!json.is_object()) input_error(path.string(), ": not a JSON object; the file is damaged");
  Exposures exposures;
  for (const auto& [name, rows] : json.items()) {
    try {
      const auto transform = rows.get<ColorTransform>();
      if (Json(transform) == rows) {  // of a longer list, the conversion takes the beginning
        exposures[name] = transform;
        continue;
      }
    } catch (const nlohmann::json::exception&) {  // reported below
    }
    input_error(path.string(), ": ", name, ": expected 3 rows of 4 numbers, found ", json_excerpt(rows));
  }
  return exposures;
}

}  // namespace b3dgs
