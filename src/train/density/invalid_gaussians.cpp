#include "train/density/invalid_gaussians.h"

#include <cmath>

#include "core/check.h"

namespace b3dgs {
namespace {

/// [N] bool, whether all values of a row are finite.
torch::Tensor finite_rows(const torch::Tensor& values) {
  const std::int64_t n = values.size(0);
  return torch::isfinite(values.reshape({n, n > 0 ? values.numel() / n : 1})).all(1);
}

}  // namespace

GaussianWidths gaussian_widths(const GaussianTensors& gaussians, const AdamState& adam) {
  GaussianWidths widths;
  widths.is_finite = torch::ones({gaussians.size()}, gaussians.means.options().dtype(torch::kBool));
  for (const GaussianTensors* group : {&gaussians, &adam.m, &adam.v}) {
    for (const torch::Tensor* tensor : group->all()) widths.is_finite.logical_and_(finite_rows(*tensor));
  }
  widths.largest = gaussians.log_scales.amax(1);
  return widths;
}

RowEdit edit_without_invalid(std::int64_t named, double extent, const GaussianWidths& widths) {
  constexpr double kAbsurd = 1e4;  // times the scene extent
  const std::int64_t n = widths.largest.size(0);
  B3DGS_CHECK(named >= 0 && named < n, "Gaussian ", named, " of ", n);
  torch::Tensor stays = widths.is_finite.clone();
  stays.slice(0, named, named + 1).fill_(false);
  const double own = widths.largest[named].item<double>();
  if (std::isfinite(own) && own > std::log(kAbsurd * extent)) stays.logical_and_(widths.largest < own);
  RowEdit edit;
  edit.sources = stays.nonzero().flatten();
  edit.n_kept = edit.sources.size(0);
  edit.new_means = torch::empty({0, 3}, widths.largest.options());
  edit.new_log_scales = torch::empty({0, 3}, widths.largest.options());
  return edit;
}

std::int64_t remove_invalid_gaussians(std::int64_t named, double extent, GaussianTensors& gaussians, AdamState& adam,
                                      DensityStatistics& statistics) {
  const std::int64_t n = gaussians.size();
  const RowEdit edit = edit_without_invalid(named, extent, gaussian_widths(gaussians, adam));
  apply_row_edit(edit, gaussians, adam, statistics);
  return n - edit.n_kept;
}

}  // namespace b3dgs
