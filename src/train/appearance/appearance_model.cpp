#include "train/appearance/appearance_model.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "core/check.h"
#include "core/files/atomic_file.h"
#include "core/files/json_file.h"
#include "core/json_text.h"
#include "core/parallel.h"
#include "raster/torch/tensors.h"
#include "raster/torch/torch_cuda.h"
#include "train/optimizer/adam.h"

namespace b3dgs {
namespace {

namespace on_cpu {

void exposure_backward(const AppearanceArgs& args) {
  parallel_pool(exposure_blocks(args), [&](std::int64_t block, int) {
    double sums[kTransformSize] = {};
    const std::int64_t end = std::min((block + 1) * kExposureBlock, args.n_pixels());
    for (std::int64_t pixel = block * kExposureBlock; pixel < end; ++pixel) expose_pixel_backward(args, pixel, sums);
    std::copy_n(sums, kTransformSize, args.sums + block * kTransformSize);
  });
  for (int k = 0; k < kTransformSize; ++k) {
    double sum = 0;
    for (std::int64_t block = 0; block < exposure_blocks(args); ++block) sum += args.sums[block * kTransformSize + k];
    args.transform_grad[k] = static_cast<float>(sum);
  }
}

void center_exposures(const AdamArgs& exposures) {
  for (int k = 0; k < kTransformSize; ++k) {
    double sum = 0;
    for (std::int64_t i = k; i < exposures.n; i += kTransformSize) sum += static_cast<double>(exposures.param[i]);
    const float excess = mean_excess(exposures, k, sum);
    for (std::int64_t i = k; i < exposures.n; i += kTransformSize) exposures.param[i] -= excess;
  }
}

/// Sums the contributions of a cell's pixels to the vertices around it.
void sum_cell(const AppearanceArgs& args, int cell) {
  const int column = cell % kCellColumns, row = cell / kCellColumns;
  double sums[kCellSums] = {};
  const std::int32_t x_end = cell_begin(column + 1, kCellColumns, args.width),
                     y_end = cell_begin(row + 1, kCellRows, args.height);
  for (std::int32_t py = cell_begin(row, kCellRows, args.height); py < y_end; ++py) {
    for (std::int32_t px = cell_begin(column, kCellColumns, args.width); px < x_end; ++px) {
      const std::int64_t pixel = std::int64_t{py} * args.width + px;
      const float *color = args.rendered + 3 * pixel, *grad = args.grad + 3 * pixel;
      const PixelPlace at = place_in_grid(args, pixel);
      for (int vertex = 0; vertex < 8; ++vertex) {
        const int corner = vertex % 4, above = vertex / 4;
        const double weight = (corner % 2 == 1 ? at.x.part : 1 - at.x.part) *
                              (corner / 2 == 1 ? at.y.part : 1 - at.y.part) * (above == 1 ? at.z.part : 1 - at.z.part);
        double* const own = sums + (corner * kGridLevels + at.z.index + above) * kTransformSize;
        for (int i = 0; i < 3; ++i) {
          const double by_output = weight * static_cast<double>(grad[i]);
          for (int k = 0; k < 3; ++k) own[4 * i + k] += by_output * static_cast<double>(color[k]);
          own[4 * i + 3] += by_output;
        }
      }
    }
  }
  std::copy_n(sums, kCellSums, args.sums + std::int64_t{cell} * kCellSums);
}

}  // namespace on_cpu

}  // namespace

AppearanceModel::AppearanceModel(const TrainConfig& config, std::int64_t n_views, torch::Device device)
    : config_(config), device_(device), n_views_(n_views) {
  const auto floats = torch::TensorOptions(torch::kFloat32).device(device);
  for (int place = 0; place < config.batch; ++place) {
    grads_.push_back(has_grids() ? torch::zeros({kGridLevels, kGridHeight, kGridWidth, kTransformSize}, floats)
                                 : torch::zeros({3, 4}, floats));
  }
  if (device.is_cpu()) step_grads_ = torch::zeros({has_grids() ? kGridSize : n_views * kTransformSize});
}

bool AppearanceModel::fits(const AppearanceState& state) const {
  const torch::Tensor& transforms = has_grids() ? state.grids : state.exposures;
  return transforms.defined() && transforms.size(0) == n_views_;
}

AppearanceState AppearanceModel::make_state() const {
  std::vector<std::int64_t> shape = grad().sizes().vec();
  shape.insert(shape.begin(), n_views_);
  const torch::Tensor identity = torch::eye(3, 4, grad().options()).flatten();
  AppearanceState state;
  torch::Tensor& transforms = has_grids() ? state.grids : state.exposures;
  transforms = identity.repeat({n_views_ * grad().numel() / kTransformSize}).view(shape);
  state.m = torch::zeros_like(transforms);
  state.v = torch::zeros_like(transforms);
  if (has_grids()) state.last_steps.assign(static_cast<std::size_t>(n_views_), 0);
  return state;
}

double AppearanceModel::rate(int iteration) const {
  if (!has_grids()) {
    return log_linear_rate(config_.exposure_lr_init, config_.exposure_lr_final, config_.iterations, iteration);
  }
  constexpr double kRate = 0.002, kLowest = 0.01, kWarmUpPart = 1.0 / 30;
  const double time = static_cast<double>(iteration) / config_.iterations;
  const double warm_up = kLowest + (1 - kLowest) * std::min(1.0, time / kWarmUpPart);
  return kRate * warm_up * std::pow(kLowest, std::min(1.0, time));
}

AppearanceArgs AppearanceModel::args_of(const AppearanceState& state, std::int32_t view,
                                        const torch::Tensor& rendered) const {
  B3DGS_CHECK(view >= 0 && fits(state) && view < n_views_, "view ", view, " of ", n_views_);
  TensorCheck check(device_);
  check.dims("rendered", rendered, {"H", "W", 3});
  if (photograph_.defined()) check.dims("photograph", photograph_, {"H", "W", 3}, torch::kUInt8);
  AppearanceArgs args;
  args.height = static_cast<std::int32_t>(rendered.size(0));
  args.width = static_cast<std::int32_t>(rendered.size(1));
  args.transform = (has_grids() ? state.grids : state.exposures).data_ptr<float>() + view * grad().numel();
  args.rendered = rendered.data_ptr<float>();
  args.photograph = data_or_null<std::uint8_t>(photograph_);
  return args;
}

torch::Tensor AppearanceModel::apply(const AppearanceState& state, std::int32_t view, const torch::Tensor& rendered) {
  AppearanceArgs args = args_of(state, view, rendered);
  place_tensor(corrected_, corrected_room_, rendered.sizes(), rendered.options());
  args.corrected = corrected_.data_ptr<float>();
  if (has_grids()) {
    for_rows<correct_pixel>(device_.is_cuda(), args, args.n_pixels());
  } else {
    for_rows<expose_pixel>(device_.is_cuda(), args, args.n_pixels());
  }
  return corrected_;
}

void AppearanceModel::backward(const AppearanceState& state, std::int32_t view, const torch::Tensor& rendered,
                               torch::Tensor grad) {
  AppearanceArgs args = args_of(state, view, rendered);
  B3DGS_CHECK(grad.sizes() == rendered.sizes(), "a gradient of ", grad.sizes(), " for a render of ", rendered.sizes());
  TensorCheck(device_).dims("grad", grad, {"H", "W", 3});
  const bool on_gpu = device_.is_cuda();
  if (kTorchHasCuda && on_gpu) args.n_parts = cuda::kCellParts;
  const std::int64_t n_sums =
      has_grids() ? std::int64_t{args.n_parts} * kCells * kCellSums : exposure_blocks(args) * kTransformSize;
  if (!sums_.defined() || sums_.numel() < n_sums) {
    sums_ = torch::empty({n_sums}, rendered.options().dtype(torch::kFloat64));
  }
  args.grad = grad.data_ptr<float>();
  args.sums = sums_.data_ptr<double>();
  args.variation_weight = static_cast<float>(config_.bilateral_grid_tv);
  args.transform_grad = this->grad().data_ptr<float>();
  if (!has_grids()) {
    if (kTorchHasCuda && on_gpu) return cuda::exposure_backward(args, torch_stream());
    return on_cpu::exposure_backward(args);
  }
  if (kTorchHasCuda && on_gpu) {
    cuda::sum_cells(args, torch_stream());
  } else {
    parallel_pool(kCells, [&](std::int64_t cell, int) { on_cpu::sum_cell(args, static_cast<int>(cell)); });
  }
  for_rows<write_grid_grad>(on_gpu, args, kGridSize);
  for_rows<correct_pixel_backward>(on_gpu, args, args.n_pixels());
}

AdamArgs AppearanceModel::adam_args(std::int32_t view, AppearanceState& state) const {
  torch::Tensor& transforms = has_grids() ? state.grids : state.exposures;
  const std::int64_t first = has_grids() ? std::int64_t{view} * kGridSize : 0;
  AdamArgs args;
  args.n = has_grids() ? kGridSize : transforms.numel();
  args.param = transforms.data_ptr<float>() + first;
  args.m = state.m.data_ptr<float>() + first;
  args.v = state.v.data_ptr<float>() + first;
  args.grad = data_or_null(step_grads_);
  return args;
}

void AppearanceModel::begin_step(std::int32_t view, int iteration, AppearanceState& state) {
  if (!has_grids()) return;
  std::int64_t& last = state.last_steps.at(static_cast<std::size_t>(view));
  // The moments of a grid are 0 before its first step, so it has missed nothing.
  const std::int64_t n_missed = last == 0 ? 0 : state.steps - last;
  last = state.steps;
  if (n_missed <= 0) return;
  MissedSteps missed;
  missed.adam = adam_args(view, state);
  missed.n = static_cast<int>(std::min<std::int64_t>(n_missed, MissedSteps::kMost));
  for (int i = 0; i < missed.n; ++i) {
    const std::int64_t step = state.steps - n_missed + 1 + i;
    missed.sizes[i] = adam_step_size(rate(static_cast<int>(iteration - 1 - (state.steps - step))), step);
  }
  const auto n_left = static_cast<double>(n_missed - missed.n);
  missed.m_factor = static_cast<float>(std::pow(kAdamBeta1, n_left));
  missed.v_factor = static_cast<float>(std::pow(kAdamBeta2, n_left));
  if (kTorchHasCuda && device_.is_cuda()) return cuda::apply_missed_steps(missed, torch_stream());
  AdamArgs& adam = missed.adam;
  for (int i = 0; i < missed.n; ++i) {
    adam.size = missed.sizes[i];
    cpu::adam_step(adam);
  }
  std::transform(adam.m, adam.m + adam.n, adam.m, [&](float m) { return m * missed.m_factor; });
  std::transform(adam.v, adam.v + adam.n, adam.v, [&](float v) { return v * missed.v_factor; });
}

void AppearanceModel::step(std::int32_t view, int iteration, AppearanceState& state) {
  ++state.steps;
  if (has_grids()) state.last_steps.at(static_cast<std::size_t>(view)) = state.steps;
  AppearanceStepArgs args;
  args.adam = adam_args(view, state);
  args.adam.size = adam_step_size(rate(iteration), state.steps);
  args.first = has_grids() ? 0 : std::int64_t{view} * kTransformSize;
  args.n_grads = grad().numel();
  args.transform_grad = grad().data_ptr<float>();
  if (kTorchHasCuda && device_.is_cuda()) {
    cuda::appearance_step(args, torch_stream());
    if (!has_grids()) cuda::center_exposures(args.adam, torch_stream());
    return;
  }
  float* const own_grads = step_grads_.data_ptr<float>() + args.first;
  std::copy_n(args.transform_grad, args.n_grads, own_grads);
  cpu::adam_step(args.adam);
  std::fill_n(own_grads, args.n_grads, 0.0f);
  if (!has_grids()) on_cpu::center_exposures(args.adam);
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
  write_file(path, dump_json(exposures, 2) + "\n");
}

Exposures read_exposures(const std::filesystem::path& path) {
  if (!std::filesystem::exists(path)) input_error(path.string(), ": cannot be opened");
  const Json json = read_json(path);
  if (!json.is_object()) input_error(path.string(), ": not a JSON object; the file is damaged");
  Exposures exposures;
  for (const auto& [name, rows] : json.items()) {
    try {
      const auto transform = rows.get<ColorTransform>();
      if (Json(transform) == rows) {  // the conversion ignores the end of longer lists
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
