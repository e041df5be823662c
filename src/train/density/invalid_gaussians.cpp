#include "train/density/invalid_gaussians.h"

#include <cmath>

#include "core/check.h"
#include "train/density/row_edit.h"

namespace b3dgs {
namespace {

/// [N] bool, whether all values of a row are finite.
torch::Tensor finite_rows(const torch::Tensor& values) {
  const std::int64_t n = values.size(0);
  return torch::isfinite(values.reshape({n, values.numel() / n})).all(1);
}

}  // namespace

std::int64_t remove_invalid_gaussians(std::int64_t named, double extent, GaussianTensors& gaussians, AdamState& adam,
                                      DensityStatistics& statistics) {
  constexpr double kAbsurd = 1e4;  // times the scene extent
  const std::int64_t n = gaussians.size();
  B3DGS_CHECK(named >= 0 && named < n, "Gaussian ", named, " of ", n);
  torch::Tensor stays = torch::ones({n}, gaussians.means.options().dtype(torch::kBool));
  for (const GaussianTensors* group : {&gaussians, &adam.m, &adam.v}) {
    for (const torch::Tensor* tensor : group->all()) stays.logical_and_(finite_rows(*tensor));
  }
  stays.slice(0, named, named + 1).fill_(false);
  const torch::Tensor largest = std::get<0>(gaussians.log_scales.max(1));
  const double own = largest[named].item<double>();
  if (std::isfinite(own) && own > std::log(kAbsurd * extent)) stays.logical_and_(largest < own);

  RowEdit edit;
  edit.sources = stays.nonzero().flatten();
  edit.n_kept = edit.sources.size(0);
  edit.new_means = torch::empty({0, 3}, gaussians.means.options());
  edit.new_log_scales = torch::empty({0, 3}, gaussians.means.options());
  apply_row_edit(edit, gaussians, adam, statistics);
  return n - edit.n_kept;
}

}  // namespace b3dgs
