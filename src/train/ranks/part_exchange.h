// The exchanges of a step whose views are drawn whole or in bands (draw_plan.h).
#pragma once

#include <torch/types.h>

#include <cstdint>
#include <vector>

#include "dist/communicator.h"
#include "raster/torch/rasterizer.h"
#include "train/ranks/draw_plan.h"
#include "train/ranks/splat_exchange.h"

namespace b3dgs {

/// Which of the M splats may touch each band, [bands, M] bool: all that do, and a few more. The same bits on every
/// rank.
torch::Tensor touches_bands(const ViewSplats& splats, const std::vector<TileRowSpan>& bands, std::int32_t tile_height);

/// Between views and parts of them: a splat goes to every rank whose band it may touch, and what the bands say about it
/// comes back as one row. With whole views, SplatExchange and nothing else.
///
/// Sums do not depend on where a view is cut. One process adds the sums of a splat's (tile, splat) pairs in the order
/// of their slots, which is row by row of tiles. Of splats that several bands draw, the pairs themselves come back, and
/// are added in that order by the same code. Where that is not wanted (a GPU without --deterministic), the sums of the
/// bands are added.
///
/// All ranks call the functions in the order in which they stand here.
class PartExchange {
 public:
  explicit PartExchange(Communicator& ranks) : ranks_(ranks), splats_(ranks) {}

  /// Begins a step: views[v] are this rank's splats of view v. Returns how many of them go to each part.
  /// @param model_rows  RowOwners::own()
  std::vector<std::int64_t> begin(const StepPlan& plan, const std::vector<ViewSplats>& views, std::int32_t tile_height,
                                  const torch::Tensor& model_rows);

  /// counts[r] are those that begin() returned on rank r. Returns the splats of the parts that this rank draws.
  std::vector<ViewSplats> to_drawers(const std::vector<std::vector<std::int64_t>>& counts);

  /// Exchanges rows of a view's images among the ranks that draw bands of it, so that each has the whole images.
  /// `images`: [H, W] or [H, W, C] floats, as rendered for this rank's part, `n_columns` floats for a pixel in all;
  /// empty on a rank that draws nothing. Nothing happens for whole views.
  void share_rows(const std::vector<torch::Tensor>& images, std::int64_t n_columns);

  /// Sums [M, 12] of the parts drawn here, as Rasterizer::backward_splats() returns them, to sums of each view's own
  /// splats. `is_exact`, the same on all ranks: pairs[i] is Rasterizer::backward_pairs() of crossing(i); otherwise the
  /// sums of bands are added.
  std::vector<torch::Tensor> sums_to_owners(const std::vector<torch::Tensor>& sums,
                                            const std::vector<SplatPairs>& pairs, bool is_exact);
  /// Rows of part i drawn here, ascending, that other bands may draw, too: [K] int64.
  torch::Tensor crossing(std::size_t i) const;

  /// Scores [M, 6] int32 of the parts drawn here, as Rasterizer::score_splats() returns them, likewise.
  std::vector<torch::Tensor> scores_to_owners(const std::vector<torch::Tensor>& scores);

  /// Of whole views: SplatExchange::columns_to_drawers().
  std::vector<torch::Tensor> columns_to_drawers(const std::vector<torch::Tensor>& own, std::int64_t n_columns,
                                                torch::ScalarType type);

  bool is_banded() const { return is_banded_; }
  std::int64_t sent_bytes() const { return splats_.sent_bytes() + sent_bytes_; }
  std::int64_t received_bytes() const { return splats_.received_bytes() + received_bytes_; }

 private:
  /// Of the parts of a view, in their order.
  std::vector<TileRowSpan> bands_of(std::size_t view) const;

  Communicator& ranks_;
  SplatExchange splats_;
  StepPlan plan_;
  bool is_banded_ = false;
  std::int32_t tile_height_ = 1;
  std::vector<std::int64_t> n_own_;    // of each view
  std::vector<torch::Tensor> places_;  // by part: which of the view's own splats go there, if banded
  std::vector<ViewSplats> drawn_;      // by part drawn here
  std::int64_t sent_bytes_ = 0, received_bytes_ = 0;
};

}  // namespace b3dgs
