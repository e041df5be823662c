// Views split at the splats on the GPU: the same checks as on the CPU (split_view_test.cpp), with gradients in a fixed
// order.
#include <gtest/gtest.h>

#include "raster/checks.h"
#include "support/raster/cuda_harness.h"
#include "support/raster/hostile_scenes.h"
#include "support/raster/split_check.h"

namespace b3dgs::test {
namespace {

DeviceArray<std::int32_t> words_to_device(const torch::Tensor& tensor) {
  const torch::Tensor words = tensor.contiguous();
  return DeviceArray<std::int32_t>(static_cast<const std::int32_t*>(words.data_ptr()), words.numel());
}

torch::Tensor words_to_host(const DeviceArray<std::int32_t>& array, torch::IntArrayRef sizes,
                            torch::ScalarType type = torch::kInt32) {
  torch::Tensor host = torch::empty(sizes, type);
  array.download(static_cast<std::int32_t*>(host.data_ptr()));
  return host;
}

/// Gaussians in device memory.
class DeviceGaussians {
 public:
  explicit DeviceGaussians(const GaussianTensors& gaussians) {
    TestScene scene;
    scene.gaussians = gaussians;
    arrays_ = arrays_of(scene);
    for (const torch::Tensor* group : gaussians.all()) groups_.push_back(to_device(*group));
    if (gaussians.filters.defined()) groups_.push_back(to_device(gaussians.filters));
    arrays_.means = groups_[0].data();
    arrays_.log_scales = groups_[1].data();
    arrays_.quats = groups_[2].data();
    arrays_.logit_opacities = groups_[3].data();
    arrays_.sh0 = groups_[4].data();
    arrays_.shN = groups_[5].data();
    arrays_.filters = gaussians.filters.defined() ? groups_[6].data() : nullptr;
  }
  const GaussianArrays& arrays() const { return arrays_; }

 private:
  std::vector<DeviceArray<float>> groups_;
  GaussianArrays arrays_;
};

/// Splats in device memory.
struct DeviceSplats {
  explicit DeviceSplats(std::int64_t n_splats) : n(n_splats), splats(12 * n), extents(2 * n), radii(n) {}
  explicit DeviceSplats(const ViewSplats& host)
      : n(host.size()),
        splats(words_to_device(host.splats)),
        extents(words_to_device(host.extents)),
        radii(words_to_device(host.radii)) {}
  SplatRowArrays arrays() const {
    return {reinterpret_cast<Splat*>(splats.data()), reinterpret_cast<Vec2f*>(extents.data()), radii.data()};
  }
  SplatRows rows() const { return {n, arrays().splats, arrays().extents, arrays().radii}; }
  ViewSplats to_host() const {
    return {words_to_host(splats, {n, 12}, torch::kFloat32), words_to_host(extents, {n, 2}, torch::kFloat32),
            words_to_host(radii, {n})};
  }

  std::int64_t n;
  DeviceArray<std::int32_t> splats, extents, radii;
};

/// What the owner of N Gaussians gets of a view of M splats, in device memory.
struct DeviceOwned {
  DeviceOwned(std::int64_t n_splats, std::int64_t n_gaussians)
      : m(n_splats), n(n_gaussians), records(12 * m), index(n), radii(n), means2d(2 * n) {
    for (int i = 0; i < 4; ++i) scores.push_back(to_device(torch::zeros({n})));
  }
  SplatRecordArrays record_arrays() const {
    return {reinterpret_cast<SplatRecord*>(records.data()), index.data(), means2d.data()};
  }
  ScoreArrays score_arrays() const { return {scores[0].data(), scores[1].data(), scores[2].data(), scores[3].data()}; }
  OwnedView to_host() const {
    OwnedView out;
    out.statistics.means2d_grad = test::to_host(means2d, {n, 2});
    out.statistics.radii = words_to_host(radii, {n});
    out.kept = {words_to_host(records, {m, 12}, torch::kFloat32), words_to_host(index, {n})};
    out.scores.error_sum = test::to_host(scores[0], {n});
    out.scores.weight_sum = test::to_host(scores[1], {n});
    out.scores.max_weight = test::to_host(scores[2], {n});
    out.scores.n_views = test::to_host(scores[3], {n});
    return out;
  }

  std::int64_t m, n;
  DeviceArray<std::int32_t> records, index, radii;
  DeviceArray<float> means2d;
  std::vector<DeviceArray<float>> scores;
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

  /// The same for several views at once, each with room for `capacity` splats; and how many it sees.
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
    Images images(scene.view);
    try {
      rasterizer_->forward(device.arrays(), scene.view, settings, images.arrays());
    } catch (const InvalidGaussianError&) {
      return std::nullopt;
    }
    WholeView view;
    view.images = images.to_host();
    const std::int64_t n = scene.gaussians.size();
    const DeviceOwned owned(rasterizer_->n_splats(), n);
    const Grad device_grad(grad);
    rasterizer_->backward_to_splats(device.arrays(), device_grad.arrays(), owned.record_arrays());
    rasterizer_->score(to_device(error).data(), owned.score_arrays());
    B3DGS_CUDA_CHECK(cudaMemcpy(owned.radii.data(), rasterizer_->radii(), static_cast<std::size_t>(n) * 4,
                                cudaMemcpyDeviceToDevice));
    view.owned = owned.to_host();
    return view;
  }

  RenderedView forward_splats(const ViewSplats& splats, const CameraView& view, const RenderSettings& settings) {
    images_.emplace(view);
    const DeviceSplats device(splats);
    rasterizer_->forward_splats(device.rows(), view, settings, images_->arrays());
    n_rows_ = splats.size();
    return images_->to_host();
  }

  torch::Tensor backward_splats(const RenderedViewGrad& grad) {
    const DeviceArray<std::int32_t> sums(12 * n_rows_);
    const Grad device_grad(grad);
    rasterizer_->backward_splats(device_grad.arrays(), reinterpret_cast<SplatGradSum*>(sums.data()));
    return words_to_host(sums, {n_rows_, 12}, torch::kFloat32);
  }

  torch::Tensor score_splats(const torch::Tensor& error) {
    const DeviceArray<std::int32_t> sums(6 * n_rows_);
    const DeviceArray<float> image = to_device(error);
    rasterizer_->score_splats(image.data(), reinterpret_cast<ScoreSums*>(sums.data()));
    return words_to_host(sums, {n_rows_, 6});
  }

  OwnedView keep(const ViewSplats& splats, const torch::Tensor& sums, const torch::Tensor& scores,
                 std::int64_t n_gaussians) {
    const DeviceSplats device(splats);
    const DeviceArray<std::int32_t> device_sums = words_to_device(sums), device_scores = words_to_device(scores);
    const DeviceOwned owned(splats.size(), n_gaussians);
    cuda::keep_splats({n_gaussians, device.rows(), reinterpret_cast<const SplatGradSum*>(device_sums.data()),
                       owned.record_arrays(), owned.radii.data()},
                      context_);
    cuda::add_scores({device.rows().splats, splats.size(), reinterpret_cast<const ScoreSums*>(device_scores.data()),
                      owned.score_arrays()},
                     /*radii=*/nullptr, context_);
    return owned.to_host();
  }

 private:
  /// Images in device memory.
  struct Images {
    explicit Images(const CameraView& view)
        : h(view.height), w(view.width), color(3 * h * w), depth(h * w), alpha(h * w) {}
    ImageArrays arrays() const { return {color.data(), depth.data(), alpha.data()}; }
    RenderedView to_host() const {
      return {test::to_host(color, {h, w, 3}), test::to_host(depth, {h, w}), test::to_host(alpha, {h, w})};
    }
    std::int64_t h, w;
    DeviceArray<float> color, depth, alpha;
  };
  struct Grad {
    explicit Grad(const RenderedViewGrad& host)
        : color(to_device(host.color)), depth(to_device(host.depth)), alpha(to_device(host.alpha)) {}
    ImageGradArrays arrays() const { return {color.data(), depth.data(), alpha.data()}; }
    DeviceArray<float> color, depth, alpha;
  };

  cuda::DriverMemory memory_;
  cuda::LaunchContext context_ = cuda::make_launch_context(nullptr, memory_);
  std::optional<Images> images_;  // the backward blend reads them
  std::int64_t n_rows_ = 0;
  std::unique_ptr<RasterizerBackend> rasterizer_ = cuda::make_rasterizer([context = context_] { return context; });
};

class SplitViewCudaTest : public testing::TestWithParam<TestSceneRow> {
 protected:
  void SetUp() override { B3DGS_NEEDS_GPU(); }
};

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

INSTANTIATE_TEST_SUITE_P(Scenes, SplitViewCudaTest, testing::ValuesIn(test_scenes()),
                         [](const auto& info) { return std::string(info.param.name); });

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

// Rows that touch no tile, as of another view, are not drawn and have no sums.
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
