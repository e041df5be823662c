// Compares the distribution of rows and the exchange of splats on a GPU with those on the CPU. One process does the
// work of each rank in turn.
#include <gtest/gtest.h>
#include <torch/types.h>

#include <vector>

#include "multi/rows.h"
#include "multi/splat_exchange.h"
#include "support/gpu_test.h"

namespace b3dgs {
namespace {

constexpr int kRanks = 3;
constexpr std::int64_t kRows = 5000;

torch::Tensor on_gpu(const torch::Tensor& tensor) {
  return tensor.to(torch::kCUDA);
}

bool are_same(const torch::Tensor& found, const torch::Tensor& expected) {
  return found.is_cuda() && found.scalar_type() == expected.scalar_type() && torch::equal(found.cpu(), expected);
}

/// Returns owners as after many edits, where any row may belong to any rank.
RowOwners random_owners(int rank, const torch::Tensor& sources) {
  return RowOwners::round_robin(rank, kRanks, kRows, sources.device()).after(sources);
}

TEST(RowOwnersOnGpu, EqualThoseOfTheCpu) {
  B3DGS_NEEDS_GPU();
  torch::manual_seed(2);
  const torch::Tensor sources = torch::randint(kRows, {kRows}, torch::kInt64);
  for (int rank = 0; rank < kRanks; ++rank) {
    const RowOwners host = random_owners(rank, sources), device = random_owners(rank, on_gpu(sources));
    EXPECT_TRUE(are_same(device.owners(), host.owners()));
    EXPECT_TRUE(are_same(device.own(), host.own()));
    EXPECT_EQ(device.n_own(), host.n_own());
    EXPECT_EQ(device.row_of_model(7), host.row_of_model(7));
    const torch::Tensor some = host.own().slice(0, 3, host.n_own(), 5).contiguous();
    EXPECT_TRUE(are_same(device.own_rows_of(on_gpu(some)), host.own_rows_of(some)));
  }
}

TEST(RowOwnersOnGpu, OwnPartsOfAnEditEqualThoseOfTheCpu) {
  B3DGS_NEEDS_GPU();
  torch::manual_seed(3);
  const torch::Tensor kept = (torch::rand({kRows}) < 0.8).nonzero().flatten();
  RowEdit host;
  host.sources = torch::cat({kept, torch::randint(kRows, {900}, torch::kInt64)});
  host.n_kept = kept.size(0);
  host.new_means = torch::randn({900, 3});
  host.new_log_scales = torch::randn({900, 3});
  host.new_logit_opacities = torch::randn({900});
  RowEdit device = host;
  for (torch::Tensor* tensor :
       {&device.sources, &device.new_means, &device.new_log_scales, &device.new_logit_opacities}) {
    *tensor = on_gpu(*tensor);
  }
  const torch::Tensor sources = torch::randint(kRows, {kRows}, torch::kInt64);
  for (int rank = 0; rank < kRanks; ++rank) {
    const OwnRowEdit expected = own_part(host, random_owners(rank, sources));
    const OwnRowEdit found = own_part(device, random_owners(rank, on_gpu(sources)));
    EXPECT_EQ(found.edit.n_kept, expected.edit.n_kept);
    EXPECT_TRUE(are_same(found.edit.sources, expected.edit.sources));
    EXPECT_TRUE(are_same(found.edit.new_means, expected.edit.new_means));
    EXPECT_TRUE(are_same(found.edit.new_log_scales, expected.edit.new_log_scales));
    EXPECT_TRUE(are_same(found.edit.new_logit_opacities, expected.edit.new_logit_opacities));
    EXPECT_TRUE(are_same(found.owners.own(), expected.owners.own()));
  }
}

TEST(SplatsOnGpu, ArePackedAndMergedAsOnTheCpu) {
  B3DGS_NEEDS_GPU();
  torch::manual_seed(4);
  const torch::Tensor sources = torch::randint(kRows, {kRows}, torch::kInt64);
  std::vector<torch::Tensor> host_words, device_words;
  std::vector<RowRange> lists;
  for (int rank = 0; rank < kRanks; ++rank) {
    const torch::Tensor own = random_owners(rank, sources).own();
    const torch::Tensor seen = (torch::rand({own.size(0)}) < 0.6).nonzero().flatten();
    const std::int64_t n = seen.size(0);
    const torch::Tensor words = torch::randint(1 << 20, {n, kSplatWords}, torch::kInt32);
    words.select(1, kGaussianColumn).copy_(seen);
    const ViewSplats host{words.view(torch::kFloat32), torch::rand({n, 2}), torch::randint(99, {n}, torch::kInt32)};
    const ViewSplats device{on_gpu(host.splats), on_gpu(host.extents), on_gpu(host.radii)};
    host_words.push_back(torch::empty({host.size(), kRowWords}, torch::kInt32));
    device_words.push_back(on_gpu(torch::zeros({device.size(), kRowWords}, torch::kInt32)));
    pack_splats(host, own, host_words.back());
    pack_splats(device, on_gpu(own), device_words.back());
    EXPECT_TRUE(are_same(device_words.back(), host_words.back())) << "rank " << rank;
    const std::int64_t begin = lists.empty() ? 0 : lists.back().end;
    lists.push_back({begin, begin + host.size()});
  }
  const MergedSplats expected = merge_splats(torch::cat(host_words), lists);
  const MergedSplats found = merge_splats(torch::cat(device_words), lists);
  EXPECT_TRUE(are_same(found.places, expected.places));
  EXPECT_TRUE(are_same(found.splats.splats.view(torch::kInt32), expected.splats.splats.view(torch::kInt32)));
  EXPECT_TRUE(are_same(found.splats.extents, expected.splats.extents));
  EXPECT_TRUE(are_same(found.splats.radii, expected.splats.radii));
}

}  // namespace
}  // namespace b3dgs
