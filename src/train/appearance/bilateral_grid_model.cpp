#include "train/appearance/appearance_model.h"

#include <algorithm>
#include <cmath>

#include "core/check.h"
#include "core/parallel.h"
#include "raster/torch/tensors.h"
#include "raster/torch/torch_cuda.h"
#include "train/optimizer/adam.h"

namespace b3dgs {
namespace {

namespace on_cpu {

constexpr int kParts = 1;

/// Calls body(x, y) for each pixel.
template <class Body>
void for_pixels(const BilateralGridArgs& args, Body&& body) {
  constexpr std::int64_t kGrain = 16;  // rows
  parallel_chunks(args.height, kGrain, [&](std::int64_t begin, std::int64_t end) {
    for (auto y = static_cast<std::int32_t>(begin); y < end; ++y) {
      for (std::int32_t x = 0; x < args.width; ++x) body(x, y);
    }
  });
}

/// What the pixels of a cell add to the vertices around it.
void sum_cell(const BilateralGridArgs& args, int cell) {
  const int column = cell % kCellColumns, row = cell / kCellColumns;
  double sums[kCellSums] = {};
  const std::int32_t x_end = cell_begin(column + 1, kCellColumns, args.width),
                     y_end = cell_begin(row + 1, kCellRows, args.height);
  for (std::int32_t py = cell_begin(row, kCellRows, args.height); py < y_end; ++py) {
    const GridPlace y = place_of_pixel(py, args.height, kCellRows);
    for (std::int32_t px = cell_begin(column, kCellColumns, args.width); px < x_end; ++px) {
      const GridPlace x = place_of_pixel(px, args.width, kCellColumns);
      const std::int64_t pixel = std::int64_t{py} * args.width + px;
      const float *color = args.rendered + 3 * pixel, *grad = args.grad + 3 * pixel;
      float slope = 0;
      const GridPlace z = place_of_color(color, slope);
      for (int vertex = 0; vertex < 8; ++vertex) {
        const int corner = vertex % 4, above = vertex / 4;
        const double weight = (corner % 2 == 1 ? x.part : 1 - x.part) * (corner / 2 == 1 ? y.part : 1 - y.part) *
                              (above == 1 ? z.part : 1 - z.part);
        double* const own = sums + (corner * kGridLevels + z.index + above) * kTransformSize;
        for (int i = 0; i < 3; ++i) {
          const double by_output = weight * static_cast<double>(grad[i]);
          for (int k = 0; k < 3; ++k) own[4 * i + k] += by_output * static_cast<double>(color[k]);
          own[4 * i + 3] += by_output;
        }
      }
    }
  }
  std::copy_n(sums, kCellSums, args.cell_sums + std::int64_t{cell} * kCellSums);
}

void backward(const BilateralGridArgs& args) {
  parallel_pool(kCells, [&](std::int64_t cell, int) { sum_cell(args, static_cast<int>(cell)); });
  constexpr std::int64_t kGrain = 1024;
  parallel_chunks(kGridSize, kGrain, [&](std::int64_t begin, std::int64_t end) {
    for (auto i = static_cast<int>(begin); i < end; ++i) args.grid_grad[i] = grid_grad(args, kParts, i);
  });
  for_pixels(args, [&](std::int32_t x, std::int32_t y) { correct_pixel_backward(args, x, y); });
}

}  // namespace on_cpu

/// The grid of one view.
AdamArgs adam_args(std::int32_t view, AppearanceState& state) {
  const std::int64_t first = std::int64_t{view} * kGridSize;
  AdamArgs args;
  args.n = kGridSize;
  args.param = state.grids.data_ptr<float>() + first;
  args.m = state.m.data_ptr<float>() + first;
  args.v = state.v.data_ptr<float>() + first;
  return args;
}

}  // namespace

BilateralGridModel::BilateralGridModel(const TrainConfig& config, std::int64_t n_views, torch::Device device)
    : AppearanceModel(config, n_views, device, &AppearanceState::grids,
                      {kGridLevels, kGridHeight, kGridWidth, kTransformSize}) {
  std::int64_t n_sums = std::int64_t{on_cpu::kParts} * kCells * kCellSums;
  if (kTorchHasCuda && device.is_cuda()) n_sums = cuda::bilateral_grid_sums();
  cell_sums_ = torch::zeros({n_sums}, torch::TensorOptions(torch::kFloat64).device(device));
  if (device.is_cpu()) no_grad_ = torch::zeros({kGridSize});
}

double BilateralGridModel::rate(int iteration) const {
  constexpr double kRate = 0.002, kLowest = 0.01, kWarmUpPart = 1.0 / 30;
  const double time = static_cast<double>(iteration) / config_.iterations;
  const double warm_up = kLowest + (1 - kLowest) * std::min(1.0, time / kWarmUpPart);
  return kRate * warm_up * std::pow(kLowest, std::min(1.0, time));
}

void BilateralGridModel::begin_step(std::int32_t view, int iteration, AppearanceState& state) {
  std::int64_t& last = state.last_steps.at(static_cast<std::size_t>(view));
  // Before its first step, a grid's moments are 0.
  const std::int64_t n_missed = last == 0 ? 0 : state.steps - last;
  last = state.steps;
  if (n_missed <= 0) return;
  MissedSteps missed;
  missed.n = static_cast<int>(std::min<std::int64_t>(n_missed, MissedSteps::kMost));
  for (int i = 0; i < missed.n; ++i) {
    const std::int64_t step = state.steps - n_missed + 1 + i;
    missed.sizes[i] = adam_step_size(rate(static_cast<int>(iteration - 1 - (state.steps - step))), step);
  }
  const auto n_left = static_cast<double>(n_missed - missed.n);
  missed.m_factor = static_cast<float>(std::pow(kAdamBeta1, n_left));
  missed.v_factor = static_cast<float>(std::pow(kAdamBeta2, n_left));
  AdamArgs args = adam_args(view, state);
  if (kTorchHasCuda && device_.is_cuda()) return cuda::apply_missed_steps(args, missed, torch_stream());
  args.grad = no_grad_.data_ptr<float>();
  for (int i = 0; i < missed.n; ++i) {
    args.size = missed.sizes[i];
    cpu::adam_step(args);
  }
  std::transform(args.m, args.m + args.n, args.m, [&](float m) { return m * missed.m_factor; });
  std::transform(args.v, args.v + args.n, args.v, [&](float v) { return v * missed.v_factor; });
}

BilateralGridArgs BilateralGridModel::args_of(const AppearanceState& state, std::int32_t view,
                                              const torch::Tensor& rendered) const {
  TensorCheck(rendered.device()).dims("rendered", rendered, {"H", "W", 3});
  BilateralGridArgs args;
  args.grid = transforms_of(state, view);
  args.height = static_cast<std::int32_t>(rendered.size(0));
  args.width = static_cast<std::int32_t>(rendered.size(1));
  args.rendered = rendered.data_ptr<float>();
  return args;
}

torch::Tensor BilateralGridModel::apply(const AppearanceState& state, std::int32_t view,
                                        const torch::Tensor& rendered) {
  BilateralGridArgs args = args_of(state, view, rendered);
  args.corrected = make_room(rendered);
  if (kTorchHasCuda && device_.is_cuda()) {
    cuda::apply_bilateral_grid(args, torch_stream());
  } else {
    on_cpu::for_pixels(args, [&](std::int32_t x, std::int32_t y) { correct_pixel(args, x, y); });
  }
  return corrected_;
}

void BilateralGridModel::backward(const AppearanceState& state, std::int32_t view, const torch::Tensor& rendered,
                                  torch::Tensor grad) {
  B3DGS_CHECK(grad.sizes() == rendered.sizes(), "a gradient of ", grad.sizes(), " for a render of ", rendered.sizes());
  TensorCheck(rendered.device()).dims("grad", grad, {"H", "W", 3});
  BilateralGridArgs args = args_of(state, view, rendered);
  args.grad = grad.data_ptr<float>();
  args.cell_sums = cell_sums_.data_ptr<double>();
  args.variation_weight = static_cast<float>(config_.bilateral_grid_tv);
  args.grid_grad = this->grad().data_ptr<float>();
  if (kTorchHasCuda && device_.is_cuda()) return cuda::bilateral_grid_backward(args, torch_stream());
  on_cpu::backward(args);
}

void BilateralGridModel::step(std::int32_t view, int iteration, AppearanceState& state) {
  ++state.steps;
  state.last_steps.at(static_cast<std::size_t>(view)) = state.steps;
  AdamArgs args = adam_args(view, state);
  args.grad = grad().data_ptr<float>();
  args.size = adam_step_size(rate(iteration), state.steps);
  if (kTorchHasCuda && device_.is_cuda()) return cuda::bilateral_grid_step(args, torch_stream());
  cpu::adam_step(args);
}

}  // namespace b3dgs
