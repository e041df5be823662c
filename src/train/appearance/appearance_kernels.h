// Colour transforms of photographs, forward and backward, without torch, shared by CPU and GPU. A transform [3, 4]
// gives colour' = transform (r, g, b, 1). A photograph has either one transform (--exposure) or a bilateral grid of
// them (--bilateral_grid).
#pragma once

#include <cstdint>

#include "core/vec.h"
#include "train/optimizer/adam_args.h"

namespace b3dgs {

inline constexpr int kTransformSize = 12;  // [3, 4]

/// Arguments of the forward and backward pass for one photograph. All arrays are on one device.
struct AppearanceArgs {
  std::int32_t width = 0, height = 0;        // px
  const float* transform = nullptr;          // [3, 4], or a grid [levels, height, width, 12]
  const float* rendered = nullptr;           // [H, W, 3]
  const std::uint8_t* photograph = nullptr;  // [H, W, 3], for exposures only; null: nothing is clipped
  float* corrected = nullptr;                // [H, W, 3] out of the forward pass
  float* grad = nullptr;                     // [H, W, 3] backward pass: dL/d(corrected) in, dL/d(rendered) out
  double* sums = nullptr;           // scratch memory of the backward pass: [blocks, 12], or [parts, cells, kCellSums]
  int n_parts = 1;                  // number of parts that a cell's sums are split into
  float variation_weight = 0;       // weight of a grid's total variation in the loss
  float* transform_grad = nullptr;  // out of the backward pass, in the shape of `transform`

  B3DGS_HD std::int64_t n_pixels() const { return std::int64_t{width} * height; }
};

// Exposures

/// Number of pixels over which the transform's gradient is summed at once. It is the same on every device, so that the
/// order of the sum depends on the image only.
inline constexpr std::int64_t kExposureBlock = 4096;

B3DGS_HD std::int64_t exposure_blocks(const AppearanceArgs& args) {
  return (args.n_pixels() + kExposureBlock - 1) / kExposureBlock;
}

/// Smallest value of a photograph that may be clipped, so that the scene may have been brighter.
inline constexpr std::uint8_t kClippedValue = 254;

/// Returns channel i of the transformed colour.
B3DGS_HD float exposed_value(const AppearanceArgs& args, std::int64_t pixel, int i) {
  const float *color = args.rendered + 3 * pixel, *a = args.transform;
  return a[4 * i] * color[0] + a[4 * i + 1] * color[1] + a[4 * i + 2] * color[2] + a[4 * i + 3];
}

/// Returns the photograph's value if it is clipped and `value` is brighter, and otherwise `value`.
B3DGS_HD float clipped_value(const AppearanceArgs& args, std::int64_t pixel, int i, float value) {
  if (args.photograph == nullptr || args.photograph[3 * pixel + i] < kClippedValue) return value;
  const float most = static_cast<float>(args.photograph[3 * pixel + i]) / 255.0f;
  return value > most ? most : value;
}

/// Writes one pixel of `corrected`.
B3DGS_HD void expose_pixel(const AppearanceArgs& args, std::int64_t pixel) {
  for (int i = 0; i < 3; ++i) {
    args.corrected[3 * pixel + i] = clipped_value(args, pixel, i, exposed_value(args, pixel, i));
  }
}

/// Replaces the pixel's gradient by that with respect to the rendered colour, and adds the pixel's contribution to
/// dL/d(transform) to `sums`.
template <class Sum>
B3DGS_HD void expose_pixel_backward(const AppearanceArgs& args, std::int64_t pixel, Sum (&sums)[kTransformSize]) {
  const float *color = args.rendered + 3 * pixel, *a = args.transform;
  float* grad = args.grad + 3 * pixel;
  float g[3] = {grad[0], grad[1], grad[2]};
  for (int i = 0; i < 3; ++i) {
    const float value = exposed_value(args, pixel, i);
    if (clipped_value(args, pixel, i, value) < value) g[i] = 0;
    for (int j = 0; j < 3; ++j) sums[4 * i + j] += static_cast<Sum>(g[i]) * static_cast<Sum>(color[j]);
    sums[4 * i + 3] += static_cast<Sum>(g[i]);
  }
  for (int j = 0; j < 3; ++j) grad[j] = a[j] * g[0] + a[4 + j] * g[1] + a[8 + j] * g[2];
}

// Bilateral grids (Wang et al. 2024, "Bilateral Guided Radiance Field Processing"). A pixel's transform is interpolated
// trilinearly between the vertices around it, by its position in the image and by the luminance of its rendered colour.
// The outer vertices are at the image's edges, and at luminances 0 and 1.

inline constexpr int kGridWidth = 16, kGridHeight = 16, kGridLevels = 8;  // number of vertices; levels are of luminance
inline constexpr int kGridSize = kGridLevels * kGridHeight * kGridWidth * kTransformSize;

/// Columns and rows of the cells between the vertices. A pixel belongs to one cell.
inline constexpr int kCellColumns = kGridWidth - 1, kCellRows = kGridHeight - 1;
inline constexpr int kCells = kCellColumns * kCellRows;
/// Number of sums of a cell, by corner (upper left, upper right, lower left, lower right), level and element.
inline constexpr int kCellSums = 4 * kGridLevels * kTransformSize;

/// Returns the first pixel of cell `cell` along an axis of `size` px that has `n_cells` cells, or `size` for `cell` =
/// n_cells. The centre of pixel i is at (i + 0.5) / size x n_cells, in cells.
B3DGS_HD std::int32_t cell_begin(std::int32_t cell, std::int32_t n_cells, std::int32_t size) {
  const std::int64_t above = std::int64_t{2} * size * cell - n_cells;  // i >= above / (2 n_cells)
  return above <= 0 ? 0 : static_cast<std::int32_t>((above + 2 * n_cells - 1) / (2 * n_cells));
}

/// A position along one axis: between vertices `index` and index + 1, at the fraction `part` of the way.
struct GridPlace {
  int index = 0;
  float part = 0;
};

/// Returns the position of pixel i on an axis of `size` px.
B3DGS_HD GridPlace place_of_pixel(std::int32_t i, std::int32_t size, int n_cells) {
  const std::int64_t doubled = (std::int64_t{2} * i + 1) * n_cells;
  const auto index = static_cast<int>(doubled / (2 * size));
  return {index, static_cast<float>(doubled - std::int64_t{2} * size * index) / static_cast<float>(2 * size)};
}

/// Returns the weight of a channel in the luminance (ITU-R BT.601).
B3DGS_HD constexpr float luminance_weight(int channel) {
  return channel == 0 ? 0.299f : channel == 1 ? 0.587f : 0.114f;
}

/// Returns the position of a colour between the levels. `slope` receives its derivative with respect to the luminance,
/// which is 0 where the luminance is clamped.
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

/// Position of a pixel in the grid. `slope` is the derivative of z with respect to the luminance.
struct PixelPlace {
  GridPlace x{}, y{}, z{};
  float slope = 0;
};

B3DGS_HD PixelPlace place_in_grid(const AppearanceArgs& args, std::int64_t pixel) {
  PixelPlace at;
  at.x = place_of_pixel(static_cast<std::int32_t>(pixel % args.width), args.width, kCellColumns);
  at.y = place_of_pixel(static_cast<std::int32_t>(pixel / args.width), args.height, kCellRows);
  at.z = place_of_color(args.rendered + 3 * pixel, at.slope);
  return at;
}

/// Returns element `element` of the transform, interpolated in x and y between the four vertices of level `level`.
B3DGS_HD float grid_in_level(const float* grid, int level, const PixelPlace& at, int element) {
  const float* const upper =
      grid + ((level * kGridHeight + at.y.index) * kGridWidth + at.x.index) * kTransformSize + element;
  const float* const lower = upper + kGridWidth * kTransformSize;
  const float above = upper[0] + at.x.part * (upper[kTransformSize] - upper[0]);
  const float below = lower[0] + at.x.part * (lower[kTransformSize] - lower[0]);
  return above + at.y.part * (below - above);
}

/// Writes one pixel of `corrected`.
B3DGS_HD void correct_pixel(const AppearanceArgs& args, std::int64_t pixel) {
  const float* const color = args.rendered + 3 * pixel;
  const PixelPlace at = place_in_grid(args, pixel);
  for (int i = 0; i < 3; ++i) {
    float sum = 0;
    for (int k = 0; k < 4; ++k) {
      const float low = grid_in_level(args.transform, at.z.index, at, 4 * i + k),
                  high = grid_in_level(args.transform, at.z.index + 1, at, 4 * i + k);
      sum += (low + at.z.part * (high - low)) * (k < 3 ? color[k] : 1.0f);
    }
    args.corrected[3 * pixel + i] = sum;
  }
}

/// Replaces one pixel's gradient by that with respect to the rendered colour, which acts through the transformed colour
/// and through the luminance.
B3DGS_HD void correct_pixel_backward(const AppearanceArgs& args, std::int64_t pixel) {
  const float* const color = args.rendered + 3 * pixel;
  float* const grad = args.grad + 3 * pixel;
  const PixelPlace at = place_in_grid(args, pixel);
  const float g[3] = {grad[0], grad[1], grad[2]};
  float sums[3] = {0, 0, 0}, by_place = 0;
  for (int i = 0; i < 3; ++i) {
    for (int k = 0; k < 4; ++k) {
      const float low = grid_in_level(args.transform, at.z.index, at, 4 * i + k),
                  high = grid_in_level(args.transform, at.z.index + 1, at, 4 * i + k);
      if (k < 3) sums[k] += (low + at.z.part * (high - low)) * g[i];
      by_place += (high - low) * (k < 3 ? color[k] : 1.0f) * g[i];
    }
  }
  const float by_luminance = at.slope * by_place;
  for (int k = 0; k < 3; ++k) grad[k] = sums[k] + luminance_weight(k) * by_luminance;
}

/// Returns the derivative of the total variation with respect to element `i` of the grid. The total variation is the
/// mean squared difference between neighbours along an axis, summed over the three axes.
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

/// Writes element `index` of dL/d(grid), from the sums of the cells and the total variation. The order of the sum is
/// fixed.
B3DGS_HD void write_grid_grad(const AppearanceArgs& args, std::int64_t index) {
  const int i = static_cast<int>(index);
  const int element = i % kTransformSize, vertex = i / kTransformSize;
  const int x = vertex % kGridWidth, y = vertex / kGridWidth % kGridHeight, level = vertex / (kGridWidth * kGridHeight);
  double sum = 0;
  for (int corner = 0; corner < 4; ++corner) {
    const int column = x - corner % 2, row = y - corner / 2;  // the cell whose corner `corner` is this vertex
    if (column < 0 || column >= kCellColumns || row < 0 || row >= kCellRows) continue;
    for (int part = 0; part < args.n_parts; ++part) {
      const std::int64_t cell = std::int64_t{part} * kCells + row * kCellColumns + column;
      sum += args.sums[cell * kCellSums + (corner * kGridLevels + level) * kTransformSize + element];
    }
  }
  args.transform_grad[i] = static_cast<float>(sum) + args.variation_weight * variation_grad(args.transform, i);
}

// Adam steps

/// An Adam step of the transforms in `adam`. Elements without a gradient still move by their moments, as with
/// torch.optim.Adam.
struct AppearanceStepArgs {
  AdamArgs adam{};                        // `grad` is used on the CPU only
  std::int64_t first = 0, n_grads = 0;    // elements that have a gradient
  const float* transform_grad = nullptr;  // [n_grads]
};

/// Returns the value to subtract from element `k` of all exposures so that their mean is the identity, given the sum of
/// these elements. Brighter transforms with a darker model would fit the photographs as well, and the first steps, when
/// renders are still dark, would lead there.
B3DGS_HD float mean_excess(const AdamArgs& exposures, int k, double sum) {
  const double identity = k % 5 == 0 ? 1 : 0;  // elements 0, 5 and 10
  return static_cast<float>(sum / static_cast<double>(exposures.n / kTransformSize) - identity);
}

/// Steps without gradient that a grid has missed. A grid is read only when its photograph is in use, but its elements
/// move by their moments in every step. The missed steps are applied before the grid is read. After kMost of them the
/// moments have all but vanished (0.9^100 = 3e-5). From then on the elements stay the same, and the moments decay as if
/// the remaining steps had been applied.
struct MissedSteps {
  static constexpr int kMost = 100;
  AdamArgs adam{};  // the grid
  int n = 0;        // number of steps to apply one by one
  AdamStepSize sizes[kMost] = {};
  float m_factor = 1, v_factor = 1;  // decay over the steps after these
};

namespace cuda {

// All functions are asynchronous, and sums have a fixed order.

/// Replaces `grad` and writes `transform_grad`, for exposures.
void exposure_backward(const AppearanceArgs& args, cudaStream_t stream);

/// Writes the sums of all parts of all cells.
void sum_cells(const AppearanceArgs& args, cudaStream_t stream);
/// AppearanceArgs::n_parts for sum_cells().
inline constexpr int kCellParts = 8;

void appearance_step(const AppearanceStepArgs& args, cudaStream_t stream);
void center_exposures(const AdamArgs& exposures, cudaStream_t stream);
void apply_missed_steps(const MissedSteps& missed, cudaStream_t stream);

}  // namespace cuda
}  // namespace b3dgs
