// Sends splats from the ranks that own the Gaussians to the rank that renders the view, and the results for these
// splats back.
#pragma once

#include <torch/types.h>

#include <cstdint>
#include <vector>

#include "dist/communicator.h"
#include "multi/splats/splat_words.h"
#include "raster/torch/rasterizer.h"

namespace b3dgs {

/// Writes the splats of a view to `words`, [splats.size(), kRowWords] int32.
/// @param model_rows  [own Gaussians] int32, index in the model of each
void pack_splats(const ViewSplats& splats, const torch::Tensor& model_rows, const torch::Tensor& words);

/// Rows [begin, end).
struct RowRange {
  std::int64_t begin = 0, end = 0;
};

/// Splats of a view from all ranks.
struct MergedSplats {
  ViewSplats splats;     // in the order of the Gaussians
  torch::Tensor places;  // [M] int64, row in `words` of each splat
};

/// Merges the splats of a view from the lists of all ranks, which are the rows `lists` of `words`, [.., kRowWords]
/// int32. Each list is ascending by Gaussian, and no Gaussian is in two lists. Returns new tensors. Does not wait for a
/// GPU.
MergedSplats merge_splats(const torch::Tensor& words, const std::vector<RowRange>& lists);

/// The exchange of one step. Every rank calls pack() and to_renderers() once, then to_owners() and
/// columns_to_renderers() as often as needed. On a GPU, the host does not wait.
class SplatExchange {
 public:
  explicit SplatExchange(Communicator& ranks) : ranks_(ranks) {}

  /// Begins a step. own[v] are this rank's splats of view v, ascending by Gaussian, where Splat::gaussian is an index
  /// among this rank's rows. renderers[v] is the rank that renders the view, the same on all ranks. Exchanges nothing,
  /// and does not wait for a GPU.
  /// @param model_rows  RowOwners::own()
  void pack(const std::vector<ViewSplats>& own, const std::vector<int>& renderers, const torch::Tensor& model_rows);

  /// Sends the splats to the ranks that render them. counts[r][v] is the number of splats of view v on rank r, the same
  /// on all ranks. Returns the splats of the views that this rank renders, in the order of the views, ascending by
  /// Gaussian, where Splat::gaussian is an index in the model.
  std::vector<ViewSplats> to_renderers(const std::vector<std::vector<std::int64_t>>& counts);

  /// Sends results back to the owners. rendered[i] is [M_i, n_columns] of `type`, with a row for each splat of result i
  /// of to_renderers(), in its order. Returns for every view v of the step the rows of own[v], in its order, as
  /// contiguous parts of one tensor. n_columns and `type` are the same on all ranks.
  std::vector<torch::Tensor> to_owners(const std::vector<torch::Tensor>& rendered, std::int64_t n_columns,
                                       torch::ScalarType type);

  /// Sends data of the owners to the ranks that render. own[v] has a row for each splat of view v that was passed to
  /// pack(). Returns for each view that this rank renders a new tensor with a row for each splat, in the order of
  /// to_renderers().
  std::vector<torch::Tensor> columns_to_renderers(const std::vector<torch::Tensor>& own);

 private:
  Communicator& ranks_;
  std::vector<int> renderers_;                // rank that renders each view
  std::vector<std::size_t> order_;            // order of the views in the exchange: by renderer
  std::vector<RowRange> own_rows_;            // rows of each view in the data that this rank sends
  torch::Tensor packed_;                      // splats between pack() and to_renderers()
  std::vector<std::int64_t> send_, receive_;  // number of rows sent to and received from each rank by to_renderers()
  std::vector<torch::Tensor> places_;         // MergedSplats::places of each view that this rank renders
};

}  // namespace b3dgs
