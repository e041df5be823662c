// Test support: checks that a view projected in one or several rasterizers and rendered in another has the same bytes
// as one that a single rasterizer renders.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cstring>
#include <optional>
#include <vector>

#include "core/check.h"
#include "support/approx.h"
#include "support/raster/cpu_harness.h"

namespace b3dgs::test {

inline bool same_bytes(const torch::Tensor& a, const torch::Tensor& b) {
  const torch::Tensor left = a.contiguous(), right = b.contiguous();
  return left.sizes() == right.sizes() && left.dtype() == right.dtype() &&
         (left.numel() == 0 || std::memcmp(left.data_ptr(), right.data_ptr(), left.nbytes()) == 0);
}

/// Returns the bits of a float tensor as int32.
inline torch::Tensor bits_of(const torch::Tensor& tensor) {
  return tensor.contiguous().view(torch::kInt32);
}

/// The data of a view for the owner of its Gaussians.
struct OwnedView {
  ViewStatistics statistics;
  SplatRecordTensors kept;
  GaussianScores scores;
};

/// A rendered view as the tests compare it. Tensors are copies in host memory.
struct WholeView {
  RenderedView images;
  OwnedView owned;
};

/// Returns rows of a view's splats, from tensors that have a row for each.
inline ViewSplats rows_of_splats(const ViewSplats& all, const torch::Tensor& rows) {
  return {all.splats.index_select(0, rows), all.extents.index_select(0, rows), all.radii.index_select(0, rows)};
}

inline torch::Tensor gaussians_of(const ViewSplats& splats) {
  return bits_of(splats.splats).select(1, 7).to(torch::kInt64);
}

inline GaussianTensors rows_of_gaussians(const GaussianTensors& all, const torch::Tensor& rows) {
  GaussianTensors some;
  for (std::size_t i = 0; i < all.all().size(); ++i) *some.all()[i] = all.all()[i]->index_select(0, rows).contiguous();
  if (all.filters.defined()) some.filters = all.filters.index_select(0, rows).contiguous();
  return some;
}

/// Compares the data that the owner of Gaussians `rows` has with the data that one rasterizer gives for all Gaussians.
/// Records may be in any order.
inline void expect_rows_of_view(const OwnedView& found, const OwnedView& all, const torch::Tensor& rows) {
  const auto expect_rows = [&](const torch::Tensor& part, const torch::Tensor& whole, const char* what) {
    EXPECT_TRUE(same_bytes(part, whole.index_select(0, rows))) << what;
  };
  expect_rows(found.statistics.means2d_grad, all.statistics.means2d_grad, "means2d_grad");
  expect_rows(found.statistics.radii, all.statistics.radii, "radii");
  expect_rows(found.scores.error_sum, all.scores.error_sum, "error_sum");
  expect_rows(found.scores.weight_sum, all.scores.weight_sum, "weight_sum");
  expect_rows(found.scores.max_weight, all.scores.max_weight, "max_weight");
  expect_rows(found.scores.n_views, all.scores.n_views, "n_views");

  const torch::Tensor own = found.kept.record_of_gaussian.to(torch::kInt64);
  const torch::Tensor whole = all.kept.record_of_gaussian.index_select(0, rows).to(torch::kInt64);
  ASSERT_TRUE(same(own < 0, whole < 0)) << "the same Gaussians have a record";
  const torch::Tensor seen = (own >= 0).nonzero().select(1, 0);
  torch::Tensor own_records = bits_of(found.kept.records).index_select(0, own.index_select(0, seen));
  const torch::Tensor whole_records = bits_of(all.kept.records).index_select(0, whole.index_select(0, seen));
  ASSERT_TRUE(same(own_records.select(1, 10).to(torch::kInt64), seen)) << "Gaussians of the records";
  own_records = own_records.clone();
  own_records.select(1, 10).copy_(rows.index_select(0, seen));
  EXPECT_TRUE(same(own_records, whole_records));
}

/// Splits the Gaussians of a scene into shards in turn, projects each with a different object of type Split, and
/// renders them with another. Split has the passes of Rasterizer and SplatOwner on host tensors:
///   std::optional<ViewSplats> project(GaussianTensors, CameraView, RenderSettings), nullopt for an invalid Gaussian
///   std::optional<WholeView> whole(scene, settings, grad, error)
///   RenderedView forward_splats(ViewSplats, CameraView, RenderSettings), backward_splats(grad), score_splats(error)
///   OwnedView keep(ViewSplats, sums, scores, n_gaussians)
/// Returns whether the scene can be rendered.
template <class Split>
bool expect_same_through_splats(const TestScene& scene, const RenderSettings& settings, std::int64_t n_shards) {
  const RenderedViewGrad grad = uneven_grad(scene.view);
  const torch::Tensor error = uneven_error(scene.view);
  const std::optional<WholeView> expected = Split().whole(scene, settings, grad, error);

  std::vector<torch::Tensor> rows, global;
  std::vector<ViewSplats> own;
  for (std::int64_t shard = 0; shard < n_shards; ++shard) {
    rows.push_back(torch::arange(std::min(shard, scene.gaussians.size()), scene.gaussians.size(), n_shards));
    const std::optional<ViewSplats> splats =
        Split().project(rows_of_gaussians(scene.gaussians, rows.back()), scene.view, settings);
    if (!splats) {
      EXPECT_FALSE(expected.has_value()) << "an invalid Gaussian in shard " << shard;
      return false;
    }
    own.push_back(*splats);
    const torch::Tensor local = gaussians_of(own.back());
    EXPECT_TRUE(local.numel() < 2 || (local.slice(0, 1) > local.slice(0, 0, -1)).all().item<bool>()) << "ascending";
    global.push_back(rows.back().index_select(0, local));
  }
  EXPECT_TRUE(expected.has_value()) << "no shard has an invalid Gaussian";
  if (!expected) return false;

  ViewSplats together;
  std::vector<torch::Tensor> parts[3];
  for (const ViewSplats& splats : own) {
    parts[0].push_back(splats.splats), parts[1].push_back(splats.extents), parts[2].push_back(splats.radii);
  }
  together = {torch::cat(parts[0]), torch::cat(parts[1]), torch::cat(parts[2])};
  const torch::Tensor order = torch::argsort(torch::cat(global));  // all different
  Split renderer;
  const RenderedView images = renderer.forward_splats(rows_of_splats(together, order), scene.view, settings);
  EXPECT_TRUE(same_bytes(images.color, expected->images.color)) << "colour";
  EXPECT_TRUE(same_bytes(images.depth, expected->images.depth)) << "depth";
  EXPECT_TRUE(same_bytes(images.alpha, expected->images.alpha)) << "alpha";

  // Return the rows to the owners: row order[k] of `together` is row k of the renderer.
  const torch::Tensor place = torch::argsort(order);
  const torch::Tensor sums = renderer.backward_splats(grad).index_select(0, place);
  const torch::Tensor scores = renderer.score_splats(error).index_select(0, place);
  EXPECT_EQ(scores.select(1, 5).count_nonzero().template item<int>(), 0) << "padding";
  std::int64_t begin = 0;
  for (std::size_t shard = 0; shard < own.size(); ++shard) {
    const std::int64_t end = begin + own[shard].size();
    const OwnedView found = Split().keep(own[shard], sums.slice(0, begin, end).contiguous(),
                                         scores.slice(0, begin, end).contiguous(), rows[shard].numel());
    expect_rows_of_view(found, expected->owned, rows[shard]);
    begin = end;
  }
  return true;
}

/// Returns the settings that matter for the split, in turn.
inline std::vector<RenderSettings> split_settings(const RenderSettings& base) {
  RenderSettings inverse = base, smooth = base;
  inverse.inverse_depth = true;
  smooth.antialiasing = true;
  smooth.culling = Culling::kSquare;
  return {base, inverse, smooth};
}

}  // namespace b3dgs::test
