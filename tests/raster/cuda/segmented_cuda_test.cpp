// Tests the segmented kernel where it differs from sub-tile: lists that are cut, pixels that finish in any segment, and
// segments that are skipped because all pixels finish before them.
#include <gtest/gtest.h>

#include <algorithm>
#include <set>
#include <vector>

#include "support/approx.h"
#include "support/raster/cuda_harness.h"

namespace b3dgs::test {
namespace {

constexpr std::int32_t kSegmentEntries = 1 << cuda::ListCut::kMaxLog2;

TEST(ListCut, DividesListsLongerThanAShare) {
  constexpr int kMultiprocessors = 100;
  const auto cut = [](std::int64_t n_pairs, std::int64_t longest) {
    cuda::ViewCounts counts{};
    counts.n_pairs = n_pairs;
    counts.longest_list = longest;
    return cuda::list_cut(counts, kMultiprocessors);
  };
  EXPECT_FALSE(cut(4'000'000, 40'000).cuts()) << "a multiprocessor's share";
  EXPECT_EQ(cut(4'000'000, 40'001).longest_whole, 10'000);
  EXPECT_EQ(cut(4'000'000, 40'001).entries_log2, 9);
  // Lists of two segments are not cut.
  EXPECT_EQ(cut(400'000, 4'001).longest_whole, 1024);
  EXPECT_EQ(cut(160'000, 2'000).entries_log2, 8) << "of at most a quarter of the share";
  EXPECT_FALSE(cut(2'000, 256).cuts());
  EXPECT_EQ(cut(2'000, 257).longest_whole, 256);
}

TEST(ListCut, SegmentsOfConsecutiveListsDoNotOverlap) {
  cuda::ListCut cut;
  for (cut.entries_log2 = cuda::ListCut::kMinLog2; cut.entries_log2 <= cuda::ListCut::kMaxLog2; ++cut.entries_log2) {
    const std::int32_t entries = 1 << cut.entries_log2;
    cut.longest_whole = 2 * entries;
    // Lists that are just long enough to be cut have the most segments for their entries.
    for (const std::int32_t length : {2 * entries + 1, 3 * entries, 3 * entries + 1, 100 * entries + 1}) {
      for (const std::int32_t whole : {0, 1, 2 * entries}) {  // length of the lists between them
        std::int64_t before = 0, end = 0;
        for (int list = 0; list < 100; ++list, before += length + whole) {
          ASSERT_GE(cut.segments_before(before), end) << length << ", " << whole << ", list " << list;
          end = cut.segments_before(before) + cut.n_segments(length);
        }
        EXPECT_GE(cut.segments_before(before), end) << "upper bound of all";
      }
    }
  }
}

/// Differences between two views and their gradients.
struct Apart {
  double color, largest_gradient;
  std::int64_t n_other_last;
};

Apart compare(CudaView& found, CudaView& expected, const TestScene& scene) {
  const torch::Tensor nothing = torch::zeros({scene.view.height, scene.view.width}, torch::kBool);
  const RenderedViewGrad grad = uneven_grad(scene.view, nothing);
  const DenseGradients own = found.backward(grad), other = expected.backward(grad);
  Apart apart{(found.color - expected.color).abs().max().item<double>(), 0,
              (found.last_gaussians() != expected.last_gaussians()).sum().item<std::int64_t>()};
  for (std::size_t i = 0; i < GaussianTensors::kNames.size(); ++i) {
    const torch::Tensor &a = *own.parameters.all()[i], &b = *other.parameters.all()[i];
    if (b.numel() == 0) continue;
    torch::Tensor size = b.norm() + 1e-20;
    // Rotating a sphere changes nothing, so its rotation gradient is only rounding error, as large as that of the scale
    // gradient.
    if (b.is_same(other.parameters.quats)) size = size + other.parameters.log_scales.norm();
    apart.largest_gradient = std::max(apart.largest_gradient, ((a - b).norm() / size).item<double>());
  }
  return apart;
}

/// Renders the scene with both kernels, which differ only in the cutting of lists. Returns whether the colours differ
/// in any bit, which they do if a segment after the first was joined.
bool expect_as_by_sub_tile(const TestScene& scene, RenderSettings settings, std::int64_t n_other_last_max) {
  settings.kernel = kStandardKernel;
  CudaView whole(scene, settings);
  settings.kernel = ForwardKernel::kSegmented;
  CudaView cut(scene, settings);
  const Apart apart = compare(cut, whole, scene);
  EXPECT_LE(apart.color, 2e-5);
  EXPECT_LE(apart.largest_gradient, 1e-4);
  EXPECT_LE(apart.n_other_last, n_other_last_max);
  return !test::same(cut.color, whole.color);
}

TEST(SegmentedCuda, CutListsGiveWhatWholeOnesDo) {
  B3DGS_NEEDS_GPU();
  const TestScene scene = ends_along_a_long_list();
  const RenderSettings settings = settings_of(scene);
  const CpuView reference(scene, settings);
  std::set<std::int32_t> segments;  // segments in which pixels end, if segments have the maximum length
  const std::int32_t* const last_ids = reference.rasterizer().last_ids();
  for (std::int64_t p = 0; p < reference.alpha.numel(); ++p) {
    if (reference.alpha.view(-1)[p].item<float>() > 0.9995f) segments.insert(last_ids[p] / kSegmentEntries);
  }
  ASSERT_GE(segments.size(), 3u) << "pixels of the scene end in several segments";

  // Rounding may move the end of a pixel near the threshold.
  EXPECT_TRUE(expect_as_by_sub_tile(scene, settings, 2)) << "no list was cut";
}

/// Makes splats that each cover the image, with faint ones in front of and behind ten opaque ones. This gives eight
/// equal lists, fewer than multiprocessors, because otherwise no list would be cut. The edge of the image cuts through
/// sub-tiles of 8 x 4 pixels, so that warps have pixels outside of it. One half of the lower tiles is outside.
TestScene wall_behind(int n_splats, int n_faint) {
  constexpr int kOpaque = 10;
  TestScene scene;
  scene.view = PinholeView{{{1, 0, 0, 0, 1, 0, 0, 0, 1}}, {}, {}, 500, 500, 30, 15, 61, 22};
  const torch::Tensor index = torch::arange(n_splats, torch::kFloat32);
  const torch::Tensor depth = 2 + 0.0001f * index;
  const torch::Tensor is_opaque = torch::logical_and(index >= n_faint, index < n_faint + kOpaque);
  const torch::Tensor opacity =
      torch::where(is_opaque, torch::full({n_splats}, 0.9f), torch::full({n_splats}, 0.0042f));
  const torch::Tensor zero = torch::zeros({n_splats});
  scene.gaussians = make_spheres(torch::stack({zero, zero, depth}, 1), torch::full({n_splats}, 5.0f), opacity);
  return scene;
}

TEST(SegmentedCuda, SegmentsBehindTheEndOfAllPixelsChangeNothing) {
  B3DGS_NEEDS_GPU();
  // On an H100, these have segments of 512, 256, and 128 entries. There are more segments of 512 than run at once, so
  // that the last ones find the first ones done.
  for (const auto& [n_splats, n_faint] :
       {std::pair(80000, 0), std::pair(80000, 1100), std::pair(20000, 1100), std::pair(4000, 1100)}) {
    SCOPED_TRACE(testing::Message() << n_splats << ", " << n_faint);
    const TestScene scene = wall_behind(n_splats, n_faint);
    RenderSettings settings = settings_of(scene);
    // All pixels end in the first segment or in one behind the second.
    EXPECT_EQ(expect_as_by_sub_tile(scene, settings, 2), n_faint > 0) << "whether segments were joined";
    settings.kernel = ForwardKernel::kSegmented;
    const CudaView cut(scene, settings);
    // Which segments are skipped differs from run to run, but the image does not.
    for (int run = 0; run < 3; ++run) {
      const CudaView again(scene, settings);
      EXPECT_TRUE(test::same(again.color, cut.color));
      EXPECT_TRUE(test::same(again.depth, cut.depth));
      EXPECT_TRUE(test::same(again.alpha, cut.alpha));
    }
  }
}

/// Makes one tile whose list has more than two thousand segments, with splats so small and faint that pixels finish
/// behind the thousandth.
TestScene crowd_in_a_tile() {
  constexpr std::int64_t kSplats = 2200 * kSegmentEntries;
  TestScene scene;
  scene.view = PinholeView{{{1, 0, 0, 0, 1, 0, 0, 0, 1}}, {}, {}, 16, 16, 8, 4, 16, 8};
  const torch::Tensor index = torch::arange(kSplats, torch::kFloat64);
  const torch::Tensor depth = 2 + 1e-6 * index;
  // Multiples of two irrational numbers, which are evenly distributed.
  const torch::Tensor x = torch::frac(0.7548776662 * index) - 0.5, y = 0.5 * (torch::frac(0.5698402910 * index) - 0.5);
  scene.gaussians = make_spheres(torch::stack({x * depth, y * depth, depth}, 1), torch::full({kSplats}, 0.125f),
                                 torch::full({kSplats}, 0.0042f));
  return scene;
}

TEST(SegmentedCuda, MoreSegmentsThanNumbersAreSortedBy) {
  B3DGS_NEEDS_GPU();
  const TestScene scene = crowd_in_a_tile();
  RenderSettings settings = settings_of(scene);
  settings.kernel = ForwardKernel::kSegmented;
  CudaView cut(scene, settings);
  EXPECT_GT(cut.alpha.min().item<float>(), 0.999f) << "all pixels end";
  const std::vector<std::int32_t> last_ids = download(cut.rasterizer().last_ids(), cut.alpha.numel());
  EXPECT_GT(*std::min_element(last_ids.begin(), last_ids.end()), 1024 * kSegmentEntries)
      << "behind what is sorted exactly";
  EXPECT_TRUE(expect_as_by_sub_tile(scene, settings, 2)) << "no list was cut";
}

TEST(SegmentedCuda, SumsInAFixedOrderRepeatBitForBit) {
  B3DGS_NEEDS_GPU();
  for (const TestScene& scene : {ends_along_a_long_list(), wall_behind(80000, 1100)}) {
    RenderSettings settings = settings_of(scene);
    settings.kernel = ForwardKernel::kSegmented;
    settings.deterministic = true;
    const torch::Tensor nothing = torch::zeros({scene.view.height, scene.view.width}, torch::kBool);
    const RenderedViewGrad grad = uneven_grad(scene.view, nothing);
    CudaView first(scene, settings);
    const DenseGradients found = first.backward(grad);
    for (int run = 0; run < 10; ++run) {  // the order in which segments finish differs from run to run
      CudaView second(scene, settings);
      const DenseGradients again = second.backward(grad);
      ASSERT_TRUE(test::same(first.color, second.color)) << "run " << run;
      for (std::size_t i = 0; i < GaussianTensors::kNames.size(); ++i) {
        ASSERT_TRUE(found.parameters.all()[i]->equal(*again.parameters.all()[i]))
            << GaussianTensors::kNames[i] << ", run " << run;
      }
    }
  }
}

}  // namespace
}  // namespace b3dgs::test
