// Tests views split at the splats on the GPU with the same checks as on the CPU (split_view_test.cpp), and with
// gradients in a fixed order.
#include <gtest/gtest.h>

#include "raster/checks.h"
#include "support/raster/cuda_harness.h"
#include "support/raster/hostile_scenes.h"
#include "support/raster/split_check.h"

namespace b3dgs::test {
namespace {

/// Splats in device memory.
struct DeviceSplats {
  explicit DeviceSplats(std::int64_t n) : splats({n, 12}), extents({n, 2}), radii({n}, torch::kInt32) {}
  explicit DeviceSplats(const ViewSplats& host) : splats(host.splats), extents(host.extents), radii(host.radii) {}
  SplatRowArrays arrays() const { return {splats.data<Splat>(), extents.data<Vec2f>(), radii.data<std::int32_t>()}; }
  SplatRows rows(std::int64_t n) const { return {n, arrays().splats, arrays().extents, arrays().radii}; }
  ViewSplats to_host() const { return {splats.to_host(), extents.to_host(), radii.to_host()}; }

  DeviceTensor splats, extents, radii;
};

/// The data that the owner of n Gaussians gets from a view of m splats, in device memory.
struct DeviceOwned {
  DeviceOwned(std::int64_t m, std::int64_t n)
      : records({m, 12}), index({n}, torch::kInt32), radii({n}, torch::kInt32), means2d({n, 2}) {
    for (int i = 0; i < 4; ++i) scores.emplace_back(torch::zeros({n}));
  }
  SplatRecordArrays record_arrays() const {
    return {records.data<SplatRecord>(), index.data<std::int32_t>(), means2d.data()};
  }
  ScoreArrays score_arrays() const { return {scores[0].data(), scores[1].data(), scores[2].data(), scores[3].data()}; }
  OwnedView to_host() const {
    OwnedView out;
    out.statistics.means2d_grad = means2d.to_host();
    out.statistics.radii = radii.to_host();
    out.kept = {records.to_host(), index.to_host()};
    out.scores.error_sum = scores[0].to_host();
    out.scores.weight_sum = scores[1].to_host();
    out.scores.max_weight = scores[2].to_host();
    out.scores.n_views = scores[3].to_host();
    return out;
  }

  DeviceTensor records, index, radii, means2d;
  std::vector<DeviceTensor> scores;
};

/// The CUDA rasterizer on tensors in host memory, for expect_same_through_splats().
class CudaSplit {
 public:
  std::optional<ViewSplats> project(const GaussianTensors& gaussians, const CameraView& view,
                                    const RenderSettings& settings) {
    const DeviceGaussians device(gaussians);
    std::optional<DeviceSplats> splats;
    std::int64_t n_second = 0;
    const SplatAllocator allocate = [&](std::int64_t n) { return splats.emplace(n).arrays(); };
    try {
      n_second = rasterizer_->project(device.arrays(), view, settings, allocate);
    } catch (const InvalidGaussianError&) {
      return std::nullopt;
    }
    ViewSplats host = splats->to_host();
    host.n_second = n_second;
    return host;
  }

  /// Projects several views at once, each with a capacity of `capacity` splats. Also returns how many splats each has.
  std::vector<std::pair<ViewSplats, SplatCounts>> project_views(const GaussianTensors& gaussians,
                                                                const std::vector<CameraView>& views,
                                                                const RenderSettings& settings, std::int64_t capacity) {
    const DeviceGaussians device(gaussians);
    std::vector<DeviceSplats> splats;
    for (std::size_t v = 0; v < views.size(); ++v) splats.emplace_back(capacity);
    for (std::size_t v = 0; v < views.size(); ++v) {
      rasterizer_->queue_projection(v, device.arrays(), views[v], settings, splats[v].arrays(), capacity);
    }
    const std::vector<SplatCounts> counts = rasterizer_->wait_for_projections();
    std::vector<std::pair<ViewSplats, SplatCounts>> all;
    for (std::size_t v = 0; v < views.size(); ++v) all.emplace_back(splats[v].to_host(), counts.at(v));
    return all;
  }

  std::optional<WholeView> whole(const TestScene& scene, const RenderSettings& settings, const RenderedViewGrad& grad,
                                 const torch::Tensor& error) {
    const DeviceGaussians device(scene.gaussians);
    const DeviceImages images(scene.view);
    try {
      rasterizer_->forward(device.arrays(), scene.view, settings, images.arrays());
    } catch (const InvalidGaussianError&) {
      return std::nullopt;
    }
    WholeView view;
    view.images = images.to_host();
    const std::int64_t n = scene.gaussians.size();
    const DeviceOwned owned(rasterizer_->n_splats(), n);
    rasterizer_->backward_to_splats(device.arrays(), DeviceImages(grad).grad(), owned.record_arrays());
    rasterizer_->score(DeviceTensor(error).data(), owned.score_arrays());
    B3DGS_CUDA_CHECK(cudaMemcpy(owned.radii.data<std::int32_t>(), rasterizer_->radii(), static_cast<std::size_t>(n) * 4,
                                cudaMemcpyDeviceToDevice));
    view.owned = owned.to_host();
    return view;
  }

  RenderedView forward_splats(const ViewSplats& splats, const CameraView& view, const RenderSettings& settings) {
    images_.emplace(view);
    const DeviceSplats device(splats);
    rasterizer_->forward_splats(device.rows(splats.size()), view, settings, images_->arrays());
    n_rows_ = splats.size();
    return images_->to_host();
  }

  torch::Tensor backward_splats(const RenderedViewGrad& grad) {
    const DeviceTensor sums({n_rows_, 12});
    rasterizer_->backward_splats(DeviceImages(grad).grad(), sums.data<SplatGradSum>());
    return sums.to_host();
  }

  torch::Tensor score_splats(const torch::Tensor& error) {
    const DeviceTensor sums({n_rows_, 6}, torch::kInt32);
    rasterizer_->score_splats(DeviceTensor(error).data(), sums.data<ScoreSums>());
    return sums.to_host();
  }

  OwnedView keep(const ViewSplats& splats, const torch::Tensor& sums, const torch::Tensor& scores,
                 std::int64_t n_gaussians) {
    const DeviceSplats device(splats);
    const DeviceTensor device_sums(sums), device_scores(scores);
    const DeviceOwned owned(splats.size(), n_gaussians);
    cuda::keep_splats({n_gaussians, device.rows(splats.size()), device_sums.data<SplatGradSum>(), owned.record_arrays(),
                       owned.radii.data<std::int32_t>()},
                      context_);
    cuda::add_scores(
        {device.rows(splats.size()).splats, splats.size(), device_scores.data<ScoreSums>(), owned.score_arrays()},
        /*radii=*/nullptr, context_);
    return owned.to_host();
  }

 private:
  DriverMemory memory_;
  cuda::LaunchContext context_ = cuda::make_launch_context(nullptr, memory_);
  std::optional<DeviceImages> images_;  // the backward blend reads them
  std::int64_t n_rows_ = 0;
  std::unique_ptr<RasterizerBackend> rasterizer_ = cuda::make_rasterizer([context = context_] { return context; });
};

class SplitViewCudaTest : public GpuSceneTest {};

TEST_P(SplitViewCudaTest, HasTheBytesOfAViewOfOneRasterizer) {
  TestScene scene = GetParam().build();
  for (RenderSettings settings : split_settings(settings_of(scene))) {
    if (settings.antialiasing) add_filters(scene);
    settings.deterministic = true;
    for (const std::int64_t shards : {1, 3}) {
      SCOPED_TRACE(testing::Message() << shards << " shards, antialiasing " << settings.antialiasing);
      EXPECT_TRUE(expect_same_through_splats<CudaSplit>(scene, settings, shards));
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Scenes, SplitViewCudaTest, testing::ValuesIn(test_scenes()), name_of_scene);

TEST(SplitViewCuda, OfManyGaussiansIsTheSame) {
  B3DGS_NEEDS_GPU();
  const TestScene scene = large_cloud();
  RenderSettings settings = settings_of(scene);
  settings.deterministic = true;
  EXPECT_TRUE(expect_same_through_splats<CudaSplit>(scene, settings, 3));
}

TEST(SplitViewCuda, OfHostileScenesIsTheSameOrRefused) {
  B3DGS_NEEDS_GPU();
  int rendered = 0, refused = 0;
  for (std::uint32_t seed = 0; seed < hostile_scene_count() && !testing::Test::HasFailure(); ++seed) {
    SCOPED_TRACE(seed);
    const TestScene scene = hostile_scene(seed);
    RenderSettings settings = hostile_settings(scene, seed);
    settings.deterministic = true;
    settings.inverse_depth = seed % 5 == 0;
    ++(expect_same_through_splats<CudaSplit>(scene, settings, 1 + seed % 3) ? rendered : refused);
  }
  EXPECT_GT(rendered, 100);
  EXPECT_GT(refused, 50);
}

TEST(SplitViewCuda, ProjectsSeveralViewsWithOneWait) {
  B3DGS_NEEDS_GPU();
  const TestScene scene = large_cloud();
  const RenderSettings settings = settings_of(scene);
  CameraView other = scene.view, panorama_view = panorama().view;
  other.width /= 2;  // sees fewer
  const std::vector<CameraView> views{scene.view, other, panorama_view, scene.view};
  CudaSplit split;
  std::vector<ViewSplats> expected;
  for (const CameraView& view : views) expected.push_back(*split.project(scene.gaussians, view, settings));
  ASSERT_LT(expected[1].size(), expected[0].size());
  ASSERT_GT(expected[1].size(), 100);
  ASSERT_GT(expected[2].n_second, 10);
  const std::int64_t all = scene.gaussians.size();
  for (const std::int64_t capacity : {all, expected[0].size(), std::int64_t{100}}) {
    const auto found = split.project_views(scene.gaussians, views, settings, capacity);
    for (std::size_t v = 0; v < views.size(); ++v) {
      EXPECT_EQ(found[v].second.n_first, expected[v].size()) << "also of a view that has no room";
      EXPECT_EQ(found[v].second.n_second, expected[v].n_second);
      const std::int64_t n = std::min(capacity, expected[v].size());
      const ViewSplats& splats = found[v].first;
      EXPECT_TRUE(same_bytes(splats.splats.slice(0, 0, n), expected[v].splats.slice(0, 0, n)));
      EXPECT_TRUE(same_bytes(splats.extents.slice(0, 0, n), expected[v].extents.slice(0, 0, n)));
      EXPECT_TRUE(same_bytes(splats.radii.slice(0, 0, n), expected[v].radii.slice(0, 0, n)));
    }
  }
}

// Rows that touch no tile, such as those of another view, are not drawn and have no sums.
TEST(SplitViewCuda, LeavesOutSplatsOutsideTheImage) {
  B3DGS_NEEDS_GPU();
  const TestScene scene = anisotropic_cloud();
  RenderSettings settings = settings_of(scene);
  settings.deterministic = true;
  CudaSplit split;
  const std::optional<ViewSplats> splats = split.project(scene.gaussians, scene.view, settings);
  ASSERT_TRUE(splats && splats->size() > 10);
  const torch::Tensor everywhere = torch::zeros({scene.view.height, scene.view.width}, torch::kBool);
  const RenderedViewGrad grad = uneven_grad(scene.view, everywhere);
  const torch::Tensor error = uneven_error(scene.view, everywhere);
  const torch::Tensor rows = torch::arange(5, splats->size());
  const ViewSplats rest = rows_of_splats(*splats, rows);
  const torch::Tensor color = split.forward_splats(rest, scene.view, settings).color;
  const torch::Tensor sums = split.backward_splats(grad), scores = split.score_splats(error);
  ViewSplats moved = *splats;
  moved.splats.slice(0, 0, 5).select(1, 0).fill_(-1e6);  // mean_x
  EXPECT_TRUE(same_bytes(split.forward_splats(moved, scene.view, settings).color, color));
  const torch::Tensor found = split.backward_splats(grad), found_scores = split.score_splats(error);
  EXPECT_TRUE(same_bytes(found.slice(0, 5), sums));
  EXPECT_EQ(found.slice(0, 0, 5).count_nonzero().item<int>(), 0);
  EXPECT_TRUE(same_bytes(found_scores.slice(0, 5), scores));
  EXPECT_EQ(found_scores.slice(0, 0, 5).count_nonzero().item<int>(), 0);
}

TEST(SplitViewCuda, RefusesWhatNeedsGaussians) {
  B3DGS_NEEDS_GPU();
  const TestScene scene = one_splat();
  RenderSettings settings = settings_of(scene);
  CudaSplit split;
  const std::optional<ViewSplats> splats = split.project(scene.gaussians, scene.view, settings);
  ASSERT_TRUE(splats);
  const torch::Tensor everywhere = torch::zeros({scene.view.height, scene.view.width}, torch::kBool);
  EXPECT_THROW(split.backward_splats(uneven_grad(scene.view, everywhere)), LogicError);
  EXPECT_THROW(split.score_splats(uneven_error(scene.view, everywhere)), LogicError);
  settings.camera_gradient = true;
  EXPECT_THROW(split.forward_splats(*splats, scene.view, settings), LogicError);
}

}  // namespace
}  // namespace b3dgs::test
