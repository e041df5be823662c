// From the splats of a view to rows of words (splat_words.h) and back, as tensors.
#pragma once

#include <torch/types.h>

#include <cstdint>
#include <vector>

#include "multi/splats/splat_words.h"
#include "raster/torch/rasterizer.h"

namespace b3dgs {

/// Writes the splats of a view to `words`, [splats.size(), kRowWords] int32.
/// @param model_rows  [own Gaussians] int32, the row of the model that each is
void pack_splats(const ViewSplats& splats, const torch::Tensor& model_rows, const torch::Tensor& words);

struct RowRange {
  std::int64_t begin = 0, end = 0;
};

struct MergedSplats {
  ViewSplats splats;     // in the order of the Gaussians
  torch::Tensor places;  // [M] int64: which row of `words` each is
};

/// The splats of a view from the lists of the ranks, which are these rows of `words`, [.., kRowWords] int32. Each list
/// is ascending by Gaussian; no Gaussian is in two. New tensors; nothing waits for a GPU.
MergedSplats merge_splats(const torch::Tensor& words, const std::vector<RowRange>& lists);

}  // namespace b3dgs
