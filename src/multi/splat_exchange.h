// Splats on their way from the ranks that own the Gaussians to the rank that renders the view, and what belongs to them
// back again.
#pragma once

#include <torch/types.h>

#include <cstdint>
#include <vector>

#include "dist/communicator.h"
#include "multi/splats/merge_splats.h"
#include "raster/torch/rasterizer.h"

namespace b3dgs {

/// The exchange of one step. Every rank calls to_renderers() once, then to_owners() and columns_to_renderers() as often
/// as needed. With one rank, the tensors are passed through as they are. On a GPU, the host does not wait.
class SplatExchange {
 public:
  explicit SplatExchange(Communicator& ranks);

  /// Begins a step: own[v] are this rank's splats of view v, ascending by Gaussian, with Splat::gaussian = own row;
  /// renderers[v] is the rank that renders it, the same on all ranks. Exchanges nothing, and does not wait for a GPU.
  /// @param model_rows  RowOwners::own()
  /// @throws LogicError if they disagree, or naming splats that do not fit
  void pack(const std::vector<ViewSplats>& own, const std::vector<int>& renderers, const torch::Tensor& model_rows);

  /// counts[r][v] is the number of splats of view v on rank r, the same on all ranks. Returns the splats of the views
  /// that this rank renders, in the order of the views, ascending by Gaussian, with Splat::gaussian = row of the model.
  /// @throws LogicError if they are not those of pack()
  std::vector<ViewSplats> to_renderers(const std::vector<std::vector<std::int64_t>>& counts);
  std::vector<ViewSplats> to_renderers(const std::vector<ViewSplats>& own,
                                       const std::vector<std::vector<std::int64_t>>& counts,
                                       const std::vector<int>& renderers, const torch::Tensor& model_rows) {
    pack(own, renderers, model_rows);
    return to_renderers(counts);
  }

  /// rendered[i] is [M_i, n_columns] of `type`, a row for each splat of result i of to_renderers(), in its order.
  /// Returns for every view v of the step the rows of own[v], in its order: contiguous parts of one tensor. n_columns
  /// and `type` are the same on all ranks. @throws LogicError naming a tensor that does not fit
  std::vector<torch::Tensor> to_owners(const std::vector<torch::Tensor>& rendered, std::int64_t n_columns,
                                       torch::ScalarType type);

  /// The way back: own[v] is [size of own[v] in to_renderers(), n_columns] of `type`. Returns for each view that this
  /// rank renders a new tensor with a row for each splat, in the order of to_renderers()'s result.
  /// @throws LogicError naming a tensor that does not fit
  std::vector<torch::Tensor> columns_to_renderers(const std::vector<torch::Tensor>& own, std::int64_t n_columns,
                                                  torch::ScalarType type);

 private:
  /// A view that this rank renders.
  struct ReceivedView {
    std::int64_t n_splats = 0;
    torch::Tensor places;  // [n_splats] int64: row of each splat in the tensor that all_to_all_rows() returned
  };

  Communicator& ranks_;
  torch::Device device_ = torch::kCPU;
  std::vector<ViewSplats> own_;               // with one rank, between pack() and to_renderers()
  torch::Tensor packed_;                      // with several, likewise
  std::vector<std::int64_t> own_counts_;      // of each view
  std::vector<std::int64_t> send_, receive_;  // rows to and from each rank, to the renderers
  std::vector<ReceivedView> received_;
  std::vector<std::vector<std::size_t>> views_of_;  // by rank: the views that it renders, ascending
};

}  // namespace b3dgs
