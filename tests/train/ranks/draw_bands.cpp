// A program of several ranks for train_ranks_tests: draw_bands RANKS SCENARIO. A view that ranks draw in bands must
// have the bytes of one that a single rasterizer draws: images, sums of splats, scores.
#include <torch/types.h>

#include <cstring>
#include <random>
#include <string>
#include <vector>

#include "core/check.h"
#include "raster/torch/splat_owner.h"
#include "support/rank_program.h"
#include "support/raster/test_scenes.h"
#include "train/ranks/part_exchange.h"
#include "train/ranks/rows/row_owners.h"

namespace b3dgs {
namespace {

using test::expect;
using test::same_bytes;
using test::TestScene;
using Counts = std::vector<std::int64_t>;

constexpr std::int64_t kGaussian = 7;  // column of Splat::gaussian

struct Drawing {
  torch::Tensor color, depth, sums, scores;
};

RenderSettings settings_of(const TestScene& scene, int variant) {
  RenderSettings settings;
  settings.background = scene.background;
  settings.sh_degree = scene.sh_degree;
  settings.tile = {16, variant % 2 == 0 ? 8 : 16};
  settings.culling = variant == 2 ? Culling::kSquare : Culling::kEllipse;
  settings.absolute_gradient = variant == 1;
  settings.inverse_depth = variant == 3;
  settings.kernel = variant == 1 ? ForwardKernel::kCombined : ForwardKernel::kSharedMemory;
  return settings;
}

torch::Tensor gaussians_of(const ViewSplats& splats) {
  return splats.splats.view(torch::kInt32).select(1, kGaussian).to(torch::kInt64);
}

/// Places of the rows of this rank.
torch::Tensor own_places(const ViewSplats& splats, const RowOwners& owners) {
  if (owners.size() == 1) return torch::arange(splats.size());
  return (owners.owners().index_select(0, gaussians_of(splats)) == owners.rank()).nonzero().flatten();
}

ViewSplats own_splats(const ViewSplats& all, const torch::Tensor& places, const RowOwners& owners) {
  ViewSplats own{all.splats.index_select(0, places), all.extents.index_select(0, places),
                 all.radii.index_select(0, places)};
  own.splats.view(torch::kInt32).select(1, kGaussian).copy_(owners.own_rows_of(gaussians_of(own)));
  return own;
}

std::vector<Counts> exchange_counts(Communicator& ranks, const Counts& own) {
  std::vector<Counts> all;
  const std::string bytes(reinterpret_cast<const char*>(own.data()), own.size() * sizeof(std::int64_t));
  for (const std::string& other : ranks.exchange("counts", bytes)) {
    all.emplace_back(other.size() / sizeof(std::int64_t));
    std::memcpy(all.back().data(), other.data(), other.size());
  }
  return all;
}

void check_view(Communicator& ranks, const TestScene& scene, int variant, const std::vector<Counts>& work) {
  // Any Gaussian may belong to any rank.
  const RowOwners owners = RowOwners::round_robin(ranks.rank(), ranks.size(), 5000, torch::kCPU)
                               .after(torch::randint(5000, {scene.gaussians.size()}, torch::kInt64));
  RenderSettings settings = settings_of(scene, variant);
  const std::vector<std::int64_t> size{scene.view.height, scene.view.width};
  const RenderedViewGrad grad{torch::randn({size[0], size[1], 3}), torch::randn(size), torch::randn(size)};
  const torch::Tensor error = torch::rand(size);
  const std::string what = "variant " + std::to_string(variant);

  // The same view once for each of `work`, by one rasterizer.
  Rasterizer rasterizer(torch::kCPU);
  const ViewSplats splats = rasterizer.project(scene.gaussians, scene.view, settings);
  const RenderedView rendered = rasterizer.forward_splats(splats, scene.view, settings);
  Drawing whole{rendered.color.clone(), rendered.depth.clone(), {}, {}};
  whole.sums = rasterizer.backward_splats(grad);
  whole.scores = rasterizer.score_splats(error);
  const torch::Tensor all_rows = torch::arange(splats.size());
  if (splats.size() > 0) {
    whole.sums = rasterizer.backward_splats(grad);
    expect(same_bytes(sum_splat_pairs(rasterizer.backward_pairs(all_rows)), whole.sums), what + ": sums of all pairs");
  }

  const StepPlan plan = counted_bands(work, ranks.size());
  const torch::Tensor places = own_places(splats, owners);
  const std::vector<ViewSplats> own(work.size(), own_splats(splats, places, owners));
  PartExchange exchange(ranks);
  const std::vector<Counts> counts =
      exchange_counts(ranks, exchange.begin(plan, own, settings.tile.height, owners.own()));
  const std::vector<ViewSplats> drawn = exchange.to_drawers(counts);
  expect(exchange.is_banded() == is_banded(plan), what + ": bands");
  std::vector<torch::Tensor> sums, scores;
  std::vector<SplatPairs> pairs;
  for (const DrawnPart& part : plan) {
    if (part.rank != ranks.rank()) continue;
    settings.drawn_rows = part.rows;
    const RenderedView image = rasterizer.forward_splats(drawn.at(sums.size()), scene.view, settings);
    exchange.share_rows({image.color, image.depth}, 4);
    expect(same_bytes(image.color, whole.color), what + ": colour");
    expect(same_bytes(image.depth, whole.depth), what + ": depth");
    sums.push_back(rasterizer.backward_splats(grad));
    if (exchange.is_banded()) pairs.push_back(rasterizer.backward_pairs(exchange.crossing(pairs.size())));
    scores.push_back(rasterizer.score_splats(error));
  }
  if (sums.empty()) exchange.share_rows({}, 4);
  const std::vector<torch::Tensor> own_sums = exchange.sums_to_owners(sums, pairs, /*is_exact=*/true);
  const std::vector<torch::Tensor> own_scores = exchange.scores_to_owners(scores);
  const std::vector<torch::Tensor> near_sums = exchange.sums_to_owners(sums, {}, /*is_exact=*/false);
  for (std::size_t v = 0; v < work.size(); ++v) {
    const torch::Tensor expected = whole.sums.index_select(0, places);
    expect(same_bytes(own_sums[v].contiguous(), expected), what + ": sums");
    expect(same_bytes(own_scores[v].contiguous(), whole.scores.index_select(0, places)), what + ": scores");
    if (expected.numel() == 0) continue;
    const double most = expected.abs().max().item<double>();
    expect((near_sums[v] - expected).abs().max().item<double>() <= 1e-4 * most, what + ": sums of bands");
  }
}

std::vector<Counts> random_work(std::mt19937& random, const TestScene& scene, int variant, std::size_t n_views) {
  const std::int32_t tile_height = settings_of(scene, variant).tile.height;
  const auto n_rows = static_cast<std::size_t>((scene.view.height + tile_height - 1) / tile_height);
  std::vector<Counts> work(n_views, Counts(n_rows));
  for (Counts& rows : work) {
    for (std::int64_t& entries : rows) entries = static_cast<std::int64_t>(random() % 100);
  }
  return work;
}

void check_scenes(Communicator& ranks) {
  std::mt19937 random(5);  // the same on all ranks
  int variant = 0;
  for (const test::TestSceneRow& row : test::test_scenes()) {
    const TestScene scene = row.build();
    for (int i = 0; i < 2; ++i, ++variant) {
      check_view(ranks, scene, variant % 4, random_work(random, scene, variant % 4, 1));
    }
  }
}

/// Several views, of which some are whole and others cut.
void check_views(Communicator& ranks) {
  std::mt19937 random(6);
  const TestScene scene = test::anisotropic_cloud();
  for (int n_views = 1; n_views <= ranks.size(); ++n_views) {
    for (int variant = 0; variant < 4; ++variant) {
      check_view(ranks, scene, variant, random_work(random, scene, variant, static_cast<std::size_t>(n_views)));
    }
  }
}

void run_scenario(const std::string& scenario, Communicator& ranks) {
  if (scenario == "views") return check_views(ranks);
  if (scenario == "scenes") return check_scenes(ranks);
  throw LogicError("unknown scenario " + scenario);
}

}  // namespace
}  // namespace b3dgs

int main(int argc, char** argv) {
  return b3dgs::test::run_scenarios(argc, argv, b3dgs::run_scenario);
}
