// Tests merging splats of several ranks into the order of one rank, without starting ranks.
#include "multi/splat_exchange.h"
#include "support/approx.h"

#include <gtest/gtest.h>
#include <torch/types.h>

#include <algorithm>
#include <random>

namespace b3dgs {
namespace {

/// Returns random splats of these Gaussians, in which all bits matter.
ViewSplats splats_of(const std::vector<std::int64_t>& gaussians) {
  const auto n = static_cast<std::int64_t>(gaussians.size());
  torch::Tensor words = torch::randint(-1000000, 1000000, {n, kSplatWords}, torch::kInt32);
  words.select(1, kGaussianColumn).copy_(torch::tensor(gaussians, torch::kInt64));
  return {words.view(torch::kFloat32), torch::randint(-1000000, 1000000, {n, 2}, torch::kInt32).view(torch::kFloat32),
          torch::randint(0, 1000, {n}, torch::kInt32)};
}

torch::Tensor bits(const torch::Tensor& floats) {
  return floats.view(torch::kInt32);
}

void expect_same(const ViewSplats& found, const ViewSplats& expected) {
  EXPECT_TRUE(test::same(bits(found.splats), bits(expected.splats)));
  EXPECT_TRUE(test::same(bits(found.extents), bits(expected.extents)));
  EXPECT_TRUE(test::same(found.radii, expected.radii));
}

TEST(MergeSplats, GivesTheOrderOfOneRank) {
  std::mt19937 random(3);
  for (const int n_ranks : {1, 2, 3, 5, 16, 32}) {
    torch::manual_seed(n_ranks);
    // Some of the 3000 Gaussians are visible, but none of rank 1.
    const auto size = static_cast<std::size_t>(n_ranks);
    std::vector<std::vector<std::int32_t>> model_rows(size);  // for the own rows of each rank
    std::vector<std::vector<std::int64_t>> seen(size);        // indices of the visible own rows
    std::vector<std::int64_t> global;
    for (std::int32_t row = 0; row < 3000; ++row) {
      const std::size_t owner = random() % size;
      model_rows[owner].push_back(row);
      if (random() % 3 == 0 || owner == 1) continue;
      seen[owner].push_back(static_cast<std::int64_t>(model_rows[owner].size()) - 1);
      global.push_back(row);
    }
    const ViewSplats whole = splats_of(global);
    // The rows that each rank sends follow rows of another view.
    torch::Tensor words = torch::full({static_cast<std::int64_t>(global.size()) + 7, kRowWords}, -1, torch::kInt32);
    std::vector<RowRange> lists;
    std::int64_t begin = 7;
    for (std::size_t r = 0; r < size; ++r) {
      const std::vector<std::int64_t>& own = seen[r];
      std::vector<std::int64_t> places;
      for (const std::int64_t row : own) {
        const std::int32_t of_model = model_rows[r][static_cast<std::size_t>(row)];
        places.push_back(std::lower_bound(global.begin(), global.end(), of_model) - global.begin());
      }
      const torch::Tensor rows = torch::tensor(places, torch::kInt64);
      ViewSplats splats{whole.splats.index_select(0, rows), whole.extents.index_select(0, rows),
                        whole.radii.index_select(0, rows)};
      splats.splats.view(torch::kInt32).select(1, kGaussianColumn).copy_(torch::tensor(own, torch::kInt64));
      const auto n = static_cast<std::int64_t>(own.size());
      pack_splats(splats, torch::tensor(model_rows[r], torch::kInt32), words.slice(0, begin, begin + n));
      lists.push_back({begin, begin + n});
      begin += n;
    }
    const MergedSplats merged = merge_splats(words, lists);
    expect_same(merged.splats, whole);
    EXPECT_TRUE(test::same(words.index_select(0, merged.places).select(1, kGaussianColumn).to(torch::kInt64),
                           torch::tensor(global, torch::kInt64)))
        << n_ranks << " ranks";
  }
}

TEST(MergeSplats, OfNothingIsNothing) {
  const torch::Tensor words = torch::empty({0, kRowWords}, torch::kInt32);
  EXPECT_EQ(merge_splats(words, {{0, 0}, {0, 0}}).splats.size(), 0);
}

}  // namespace
}  // namespace b3dgs
