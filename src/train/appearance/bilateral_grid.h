// A bilateral grid of affine colour transforms (Wang et al. 2024, "Bilateral Guided Radiance Field Processing"),
// forward and backward, without torch: what CPU and GPU share.
//
// A vertex of the grid holds a 3 x 4 transform. A pixel's transform is interpolated trilinearly between the vertices
// around it, by its position in the image and by the luminance of its rendered colour: colour' = transform (r, g, b,
// 1). The outer vertices are at the image's edges, and at luminances 0 and 1.
#pragma once

#include <cstdint>

#include "core/vec.h"
#include "train/optimizer/adam_args.h"

namespace b3dgs {

inline constexpr int kGridWidth = 16, kGridHeight = 16, kGridLevels = 8;  // vertices; levels of luminance
inline constexpr int kTransformSize = 12;                                 // [3, 4]
/// Elements of a grid [levels, height, width, 12].
inline constexpr int kGridSize = kGridLevels * kGridHeight * kGridWidth * kTransformSize;

/// Columns and rows of cells between the vertices; a pixel belongs to one cell.
inline constexpr int kCellColumns = kGridWidth - 1, kCellRows = kGridHeight - 1;
inline constexpr int kCells = kCellColumns * kCellRows;
/// Sums of a cell: by corner (upper left, upper right, lower left, lower right), level and element.
inline constexpr int kCellSums = 4 * kGridLevels * kTransformSize;

/// All arrays are on one device.
struct BilateralGridArgs {
  std::int32_t width = 0, height = 0;  // px
  const float* grid = nullptr;         // [levels, height, width, 12]
  const float* rendered = nullptr;     // [H, W, 3]
  float* corrected = nullptr;          // [H, W, 3] out of the forward pass
  float* grad = nullptr;               // [H, W, 3] backward pass: dL/d(corrected) in, dL/d(rendered) out
  double* cell_sums = nullptr;         // scratch of the backward pass
  float variation_weight = 0;          // of the total variation in the loss
  float* grid_grad = nullptr;          // [levels, height, width, 12] out of the backward pass
};

/// First pixel of cell `cell` along an axis of `size` px that has `n_cells`: the centre of pixel i is at
/// (i + 0.5) / size x n_cells, in cells. For `cell` = n_cells: size.
B3DGS_HD std::int32_t cell_begin(std::int32_t cell, std::int32_t n_cells, std::int32_t size) {
  const std::int64_t above = std::int64_t{2} * size * cell - n_cells;  // i >= above / (2 n_cells)
  return above <= 0 ? 0 : static_cast<std::int32_t>((above + 2 * n_cells - 1) / (2 * n_cells));
}

/// A place along one axis: between vertices `index` and index + 1, at `part` of the way.
struct GridPlace {
  int index = 0;
  float part = 0;
};

/// Of pixel i of `size`.
B3DGS_HD GridPlace place_of_pixel(std::int32_t i, std::int32_t size, int n_cells) {
  const std::int64_t doubled = (std::int64_t{2} * i + 1) * n_cells;
  const auto index = static_cast<int>(doubled / (2 * size));
  return {index, static_cast<float>(doubled - std::int64_t{2} * size * index) / static_cast<float>(2 * size)};
}

/// Weight of a channel in the luminance (ITU-R BT.601).
B3DGS_HD constexpr float luminance_weight(int channel) {
  return channel == 0 ? 0.299f : channel == 1 ? 0.587f : 0.114f;
}

/// Place of a colour among the levels. `slope`: its derivative by the luminance, 0 where the luminance is clamped.
B3DGS_HD GridPlace place_of_color(const float* color, float& slope) {
  constexpr int kLast = kGridLevels - 1;
  const float luminance =
      luminance_weight(0) * color[0] + luminance_weight(1) * color[1] + luminance_weight(2) * color[2];
  const bool is_inside = luminance > 0 && luminance < 1;  // false for NaN
  slope = is_inside ? static_cast<float>(kLast) : 0.0f;
  if (!is_inside) return luminance >= 1 ? GridPlace{kLast - 1, 1.0f} : GridPlace{0, 0.0f};
  const float place = static_cast<float>(kLast) * luminance;
  int index = static_cast<int>(place);
  if (index > kLast - 1) index = kLast - 1;
  return {index, place - static_cast<float>(index)};
}

/// Interpolated in x and y between four vertices of level `level`; `element` is of the transform.
B3DGS_HD float grid_in_level(const float* grid, int level, const GridPlace& x, const GridPlace& y, int element) {
  const float* const upper = grid + ((level * kGridHeight + y.index) * kGridWidth + x.index) * kTransformSize + element;
  const float* const lower = upper + kGridWidth * kTransformSize;
  const float above = upper[0] + x.part * (upper[kTransformSize] - upper[0]);
  const float below = lower[0] + x.part * (lower[kTransformSize] - lower[0]);
  return above + y.part * (below - above);
}

/// Writes one pixel of `corrected`.
B3DGS_HD void correct_pixel(const BilateralGridArgs& args, std::int32_t px, std::int32_t py) {
  const std::int64_t pixel = std::int64_t{py} * args.width + px;
  const float* const color = args.rendered + 3 * pixel;
  const GridPlace x = place_of_pixel(px, args.width, kCellColumns), y = place_of_pixel(py, args.height, kCellRows);
  float slope;
  const GridPlace z = place_of_color(color, slope);
  for (int i = 0; i < 3; ++i) {
    float sum = 0;
    for (int k = 0; k < 4; ++k) {
      const float low = grid_in_level(args.grid, z.index, x, y, 4 * i + k),
                  high = grid_in_level(args.grid, z.index + 1, x, y, 4 * i + k);
      sum += (low + z.part * (high - low)) * (k < 3 ? color[k] : 1.0f);
    }
    args.corrected[3 * pixel + i] = sum;
  }
}

/// Replaces one pixel's gradient. The rendered colour acts through the transformed colour and through the luminance.
B3DGS_HD void correct_pixel_backward(const BilateralGridArgs& args, std::int32_t px, std::int32_t py) {
  const std::int64_t pixel = std::int64_t{py} * args.width + px;
  const float* const color = args.rendered + 3 * pixel;
  float* const grad = args.grad + 3 * pixel;
  const GridPlace x = place_of_pixel(px, args.width, kCellColumns), y = place_of_pixel(py, args.height, kCellRows);
  float slope;
  const GridPlace z = place_of_color(color, slope);
  const float g[3] = {grad[0], grad[1], grad[2]};
  float sums[3] = {0, 0, 0}, by_place = 0;
  for (int i = 0; i < 3; ++i) {
    for (int k = 0; k < 4; ++k) {
      const float low = grid_in_level(args.grid, z.index, x, y, 4 * i + k),
                  high = grid_in_level(args.grid, z.index + 1, x, y, 4 * i + k);
      if (k < 3) sums[k] += (low + z.part * (high - low)) * g[i];
      by_place += (high - low) * (k < 3 ? color[k] : 1.0f) * g[i];
    }
  }
  const float by_luminance = slope * by_place;
  for (int k = 0; k < 3; ++k) grad[k] = sums[k] + luminance_weight(k) * by_luminance;
}

/// Derivative of the total variation by element `i` of the grid. The total variation is, summed over the three axes,
/// the mean squared difference between neighbours along the axis.
B3DGS_HD float variation_grad(const float* grid, int i) {
  constexpr int kSteps[3] = {kTransformSize, kTransformSize * kGridWidth, kTransformSize * kGridWidth * kGridHeight};
  constexpr int kSizes[3] = {kGridWidth, kGridHeight, kGridLevels};
  float sum = 0;
  for (int axis = 0; axis < 3; ++axis) {
    const int place = i / kSteps[axis] % kSizes[axis];
    float difference = 0;
    if (place > 0) difference += grid[i] - grid[i - kSteps[axis]];
    if (place < kSizes[axis] - 1) difference += grid[i] - grid[i + kSteps[axis]];
    const int n_pairs = kGridSize / kSizes[axis] * (kSizes[axis] - 1);
    sum += 2.0f * difference / static_cast<float>(n_pairs);
  }
  return sum;
}

/// Element `i` of dL/d(grid), from the cells' sums [n_parts, cells, 4, levels, 12] and the total variation. The order
/// of the sum is fixed.
B3DGS_HD float grid_grad(const BilateralGridArgs& args, int n_parts, int i) {
  const int element = i % kTransformSize, vertex = i / kTransformSize;
  const int x = vertex % kGridWidth, y = vertex / kGridWidth % kGridHeight, level = vertex / (kGridWidth * kGridHeight);
  double sum = 0;
  for (int corner = 0; corner < 4; ++corner) {
    const int column = x - corner % 2, row = y - corner / 2;  // the cell of which this vertex is that corner
    if (column < 0 || column >= kCellColumns || row < 0 || row >= kCellRows) continue;
    for (int part = 0; part < n_parts; ++part) {
      const std::int64_t cell = std::int64_t{part} * kCells + row * kCellColumns + column;
      sum += args.cell_sums[cell * kCellSums + (corner * kGridLevels + level) * kTransformSize + element];
    }
  }
  return static_cast<float>(sum) + args.variation_weight * variation_grad(args.grid, i);
}

/// Deferred Adam steps without gradient, then one with gradient. A grid is read only when its photograph is in use, but
/// its elements move by their moments in every step, as with torch.optim.Adam. Before the grid is read, the steps that
/// it has missed are applied. After kMost of them the moments have all but vanished (0.9^100 = 3e-5): the elements
/// stay, and the moments shrink as if the remaining steps had been applied.
struct MissedSteps {
  static constexpr int kMost = 100;
  int n = 0;  // to be applied one by one
  AdamStepSize sizes[kMost] = {};
  float m_factor = 1, v_factor = 1;  // of those after them
};

namespace cuda {

// Everything is asynchronous.

void apply_bilateral_grid(const BilateralGridArgs& args, cudaStream_t stream);

/// Doubles of BilateralGridArgs::cell_sums.
std::int64_t bilateral_grid_sums();

/// Sums have a fixed order.
void bilateral_grid_backward(const BilateralGridArgs& args, cudaStream_t stream);

/// `adam` is one grid.
void apply_missed_steps(const AdamArgs& adam, const MissedSteps& missed, cudaStream_t stream);

void bilateral_grid_step(const AdamArgs& adam, cudaStream_t stream);

}  // namespace cuda
}  // namespace b3dgs
