// What density control records of each Gaussian between two rounds.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "raster/torch/rasterizer.h"

namespace b3dgs {

struct DensityStatistics {
  /// A further column of one strategy.
  struct Column {
    std::string name;
    torch::Tensor values;  // [N] float
  };

  // [N] float, sum over views of the norm of dL/d(projected centre) in normalised device coordinates: dL/dpx times half
  // the image size.
  torch::Tensor grad_norm_sum;
  torch::Tensor view_count;  // [N] int32, views that saw the Gaussian
  torch::Tensor max_radii;   // [N] int32, px, largest radius in any of them
  std::vector<Column> extra;

  /// All columns and their names, in the order of a checkpoint.
  std::vector<torch::Tensor*> all() {
    std::vector<torch::Tensor*> columns{&grad_norm_sum, &view_count, &max_radii};
    for (Column& column : extra) columns.push_back(&column.values);
    return columns;
  }
  std::vector<const torch::Tensor*> all() const {
    std::vector<const torch::Tensor*> columns{&grad_norm_sum, &view_count, &max_radii};
    for (const Column& column : extra) columns.push_back(&column.values);
    return columns;
  }
  std::vector<std::string> names() const {
    std::vector<std::string> names{"grad_norm_sum", "view_count", "max_radii"};
    for (const Column& column : extra) names.push_back(column.name);
    return names;
  }
};

/// Zeros, without extra columns.
DensityStatistics make_density_statistics(std::int64_t n_gaussians, torch::Device device);

/// Adds one view of width x height px. A gradient in 1/px times half the width (height) is one in normalised device
/// coordinates, the unit of the original 3DGS threshold. Allocates nothing.
void add_view(const ViewStatistics& view, std::int32_t width, std::int32_t height, DensityStatistics& statistics);

}  // namespace b3dgs
