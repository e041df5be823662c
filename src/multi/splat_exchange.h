// Splats on their way from the ranks that own the Gaussians to the rank that draws the view, and what belongs to them
// back again.
#pragma once

#include <torch/types.h>

#include <cstdint>
#include <vector>

#include "dist/communicator.h"
#include "multi/splats/merge_splats.h"
#include "raster/torch/rasterizer.h"

namespace b3dgs {

/// The exchange of one step. Every rank calls to_drawers() once, then to_owners() and columns_to_drawers() as often as
/// needed. With one rank, the tensors are passed through as they are. On a GPU, the host does not wait.
class SplatExchange {
 public:
  explicit SplatExchange(Communicator& ranks);

  /// Begins a step: own[v] are this rank's splats of view v, ascending by Gaussian, with Splat::gaussian = own row;
  /// drawers[v] is the rank that draws it, the same on all ranks. Exchanges nothing, and does not wait for a GPU.
  /// @param model_rows  RowOwners::own()
  /// @throws LogicError if they disagree, or naming splats that do not fit
  void pack(const std::vector<ViewSplats>& own, const std::vector<int>& drawers, const torch::Tensor& model_rows);

  /// counts[r][v] is the number of splats of view v on rank r, the same on all ranks. Returns the splats of the views
  /// that this rank draws, in the order of the views, ascending by Gaussian, with Splat::gaussian = row of the model.
  /// @throws LogicError if they are not those of pack()
  std::vector<ViewSplats> to_drawers(const std::vector<std::vector<std::int64_t>>& counts);
  std::vector<ViewSplats> to_drawers(const std::vector<ViewSplats>& own,
                                     const std::vector<std::vector<std::int64_t>>& counts,
                                     const std::vector<int>& drawers, const torch::Tensor& model_rows) {
    pack(own, drawers, model_rows);
    return to_drawers(counts);
  }

  /// drawn[i] is [M_i, n_columns] of `type`, a row for each splat of result i of to_drawers(), in its order. Returns
  /// for every view v of the step the rows of own[v], in its order: contiguous parts of one tensor. n_columns and
  /// `type` are the same on all ranks. @throws LogicError naming a tensor that does not fit
  std::vector<torch::Tensor> to_owners(const std::vector<torch::Tensor>& drawn, std::int64_t n_columns,
                                       torch::ScalarType type);

  /// The way back: own[v] is [size of own[v] in to_drawers(), n_columns] of `type`. Returns for each view that this
  /// rank draws a new tensor with a row for each splat, in the order of to_drawers()'s result.
  /// @throws LogicError naming a tensor that does not fit
  std::vector<torch::Tensor> columns_to_drawers(const std::vector<torch::Tensor>& own, std::int64_t n_columns,
                                                torch::ScalarType type);

 private:
  /// A view that this rank draws.
  struct DrawnView {
    std::int64_t n_splats = 0;
    torch::Tensor places;  // [n_splats] int64: row of each splat in the tensor that all_to_all_rows() returned
  };

  Communicator& ranks_;
  torch::Device device_ = torch::kCPU;
  std::vector<ViewSplats> own_;               // with one rank, between pack() and to_drawers()
  torch::Tensor packed_;                      // with several, likewise
  std::vector<std::int64_t> own_counts_;      // of each view
  std::vector<std::int64_t> send_, receive_;  // rows to and from each rank, to the drawers
  std::vector<DrawnView> drawn_;
  std::vector<std::vector<std::size_t>> views_of_;  // by rank: the views that it draws, ascending
};

}  // namespace b3dgs
