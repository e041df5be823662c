// Tests views split at the splats: projected in one rasterizer, rendered in another, and summed by the owner of the
// Gaussians.
#include <gtest/gtest.h>

#include "raster/checks.h"
#include "raster/torch/rasterizer.h"
#include "support/approx.h"
#include "support/expect_error.h"
#include "support/raster/hostile_scenes.h"
#include "support/raster/split_check.h"

namespace b3dgs::test {
namespace {

/// The torch layer on the CPU, for expect_same_through_splats().
class CpuSplit {
 public:
  std::optional<ViewSplats> project(const GaussianTensors& gaussians, const CameraView& view,
                                    const RenderSettings& settings) {
    try {
      return rasterizer_.project(gaussians, view, settings);
    } catch (const InvalidGaussianError&) {
      return std::nullopt;
    }
  }

  std::optional<WholeView> whole(const TestScene& scene, const RenderSettings& settings, const RenderedViewGrad& grad,
                                 const torch::Tensor& error) {
    WholeView view;
    try {
      view.images = rasterizer_.forward(scene.gaussians, scene.view, settings);
    } catch (const InvalidGaussianError&) {
      return std::nullopt;
    }
    const std::int64_t n = scene.gaussians.size();
    view.owned = {{}, make_room(rasterizer_.view_size().n_splats, n), make_scores(n)};
    view.owned.statistics = rasterizer_.backward_to_splats(scene.gaussians, grad, view.owned.kept);
    view.owned.statistics.radii = view.owned.statistics.radii.clone();  // of the rasterizer's own memory
    rasterizer_.score(error, view.owned.scores);
    return view;
  }

  RenderedView forward_splats(const ViewSplats& splats, const CameraView& view, const RenderSettings& settings) {
    return rasterizer_.forward_splats(splats, view, settings);
  }
  torch::Tensor backward_splats(const RenderedViewGrad& grad) { return rasterizer_.backward_splats(grad); }
  torch::Tensor score_splats(const torch::Tensor& error) { return rasterizer_.score_splats(error); }

  OwnedView keep(const ViewSplats& splats, const torch::Tensor& sums, const torch::Tensor& scores,
                 std::int64_t n_gaussians) {
    OwnedView out{{}, make_room(splats.size(), n_gaussians), make_scores(n_gaussians)};
    SplatOwner owner;
    out.statistics = owner.keep(splats, sums, n_gaussians, out.kept);
    add_splat_scores(splats, scores, out.scores);
    return out;
  }

 private:
  static SplatRecordTensors make_room(std::int64_t n_splats, std::int64_t n_gaussians) {
    return {torch::full({n_splats, 12}, NAN), torch::full({n_gaussians}, -7, torch::kInt32)};
  }
  Rasterizer rasterizer_{torch::kCPU};
};

class SplitViewTest : public testing::TestWithParam<TestSceneRow> {};

TEST_P(SplitViewTest, HasTheBytesOfAViewOfOneRasterizer) {
  TestScene scene = GetParam().build();
  for (const RenderSettings& settings : split_settings(settings_of(scene))) {
    if (settings.antialiasing) add_filters(scene);
    for (const std::int64_t shards : {1, 3}) {
      SCOPED_TRACE(testing::Message() << shards << " shards, antialiasing " << settings.antialiasing);
      EXPECT_TRUE(expect_same_through_splats<CpuSplit>(scene, settings, shards));
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Scenes, SplitViewTest, testing::ValuesIn(test_scenes()),
                         [](const auto& info) { return std::string(info.param.name); });

TEST(SplitView, OfManyGaussiansIsTheSameForAnyNumberOfThreads) {
  const TestScene scene = large_cloud();
  const RenderSettings settings = settings_of(scene);
  for (const int threads : {1, 3}) {
    const ScopedThreadCount scoped(threads);
    EXPECT_TRUE(expect_same_through_splats<CpuSplit>(scene, settings, 3));
  }
}

/// Returns the gradient with respect to the camera for a view of one rasterizer, and for one of two owners.
std::pair<torch::Tensor, torch::Tensor> camera_gradients(const TestScene& scene, const RenderSettings& settings) {
  const RenderedViewGrad grad = uneven_grad(scene.view);
  RenderSettings with_camera = settings;
  with_camera.camera_gradient = true;
  Rasterizer whole(torch::kCPU), owner(torch::kCPU), renderer(torch::kCPU);
  whole.forward(scene.gaussians, scene.view, with_camera);
  GaussianTensors grads;
  const torch::Tensor expected = whole.backward(scene.gaussians, grad, grads).camera_grad.clone();
  EXPECT_GT(expected.abs().min().item<double>(), 0);

  const ViewSplats all = owner.project(scene.gaussians, scene.view, settings);
  renderer.forward_splats(all, scene.view, settings);
  const torch::Tensor sums = renderer.backward_splats(grad);
  std::vector<torch::Tensor> parts;
  const torch::Tensor gaussians = gaussians_of(all);
  const std::int64_t n = scene.gaussians.size(), n_first = (gaussians < n / 3).sum().item<std::int64_t>();
  EXPECT_GT(n_first, 0);
  for (const auto& [begin, end] : {std::pair{std::int64_t{0}, n_first}, {n_first, all.size()}}) {
    const torch::Tensor rows = torch::arange(begin, end), own = gaussians.slice(0, begin, end);
    ViewSplats splats = rows_of_splats(all, rows);
    bits_of(splats.splats).select(1, 7).copy_(torch::arange(end - begin));
    parts.push_back(
        camera_parts(rows_of_gaussians(scene.gaussians, own), splats, sums.slice(0, begin, end), scene.view, settings));
  }
  return {expected, sum_camera_parts(torch::cat(parts))};
}

TEST(SplitView, HasTheCameraGradientOfAViewOfOneRasterizer) {
  TestScene scene = large_cloud();
  add_filters(scene);
  for (const RenderSettings& settings : split_settings(settings_of(scene))) {
    const auto [expected, found] = camera_gradients(scene, settings);
    EXPECT_TRUE(same_bytes(found, expected));
  }
}

TEST(SplitView, HasTheCameraGradientOfAPanoramaUpToRounding) {
  const TestScene scene = panorama();
  const auto [expected, found] = camera_gradients(scene, settings_of(scene));
  EXPECT_TRUE(within(found, expected, 1e-5 * expected.abs()));
}

TEST(SplitView, OfHostileScenesIsTheSameOrRefused) {
  int rendered = 0, refused = 0;
  for (std::uint32_t seed = 0; seed < hostile_scene_count() && !testing::Test::HasFailure(); ++seed) {
    SCOPED_TRACE(seed);
    const TestScene scene = hostile_scene(seed);
    RenderSettings settings = hostile_settings(scene, seed);
    settings.inverse_depth = seed % 5 == 0;
    ++(expect_same_through_splats<CpuSplit>(scene, settings, 1 + seed % 3) ? rendered : refused);
  }
  EXPECT_GT(rendered, 100);
  EXPECT_GT(refused, 50);
}

TEST(SplitView, NamesTheFirstInvalidGaussian) {
  TestScene scene = anisotropic_cloud();
  scene.gaussians.means[7][1] = NAN;
  try {
    Rasterizer(torch::kCPU).project(scene.gaussians, scene.view, settings_of(scene));
    FAIL() << "an invalid Gaussian was projected";
  } catch (const InvalidGaussianError& error) {
    EXPECT_EQ(error.row(), 7);
  }
}

TEST(SplitView, WithoutSplatsIsTheBackground) {
  const TestScene scene = one_splat();
  Rasterizer rasterizer(torch::kCPU);
  const ViewSplats none{torch::empty({0, 12}), torch::empty({0, 2}), torch::empty({0}, torch::kInt32)};
  const RenderedView images = rasterizer.forward_splats(none, scene.view, settings_of(scene));
  const Vec3f back = scene.background;
  EXPECT_TRUE(test::same(images.color, torch::tensor({back.x, back.y, back.z}).expand_as(images.color)));
  EXPECT_EQ(images.alpha.count_nonzero().item<int>(), 0);
  EXPECT_EQ(rasterizer.backward_splats(uneven_grad(scene.view)).sizes(), (std::vector<std::int64_t>{0, 12}));
  EXPECT_EQ(rasterizer.score_splats(uneven_error(scene.view)).sizes(), (std::vector<std::int64_t>{0, 6}));
}

TEST(SplitView, IgnoresTheGaussiansOfSplats) {
  const TestScene scene = anisotropic_cloud();
  Rasterizer rasterizer(torch::kCPU);
  const ViewSplats splats = rasterizer.project(scene.gaussians, scene.view, settings_of(scene));
  const torch::Tensor color = rasterizer.forward_splats(splats, scene.view, settings_of(scene)).color.clone();
  bits_of(splats.splats).select(1, 7).fill_(-123456789);
  EXPECT_TRUE(test::same(rasterizer.forward_splats(splats, scene.view, settings_of(scene)).color, color));
  EXPECT_TRUE((gaussians_of(splats) == -123456789).all().item<bool>()) << "its argument is not changed";
}

TEST(SplitView, CanBeReblendedAndItsLoadCounted) {
  for (const TestScene& scene : {saturated_pixels(), panorama()}) {
    const RenderSettings settings = settings_of(scene);
    Rasterizer whole(torch::kCPU), split(torch::kCPU);
    whole.forward(scene.gaussians, scene.view, settings);
    const ViewSplats splats = split.project(scene.gaussians, scene.view, settings);
    split.forward_splats(splats, scene.view, settings);
    EXPECT_TRUE(
        test::same(split.reblend(ForwardKernel::kSegmented).color, whole.reblend(ForwardKernel::kSegmented).color));
    EXPECT_TRUE(test::same(split.count_load().processed, whole.count_load().processed));
    EXPECT_EQ(split.view_size().n_splats, whole.view_size().n_splats);
    EXPECT_EQ(split.view_size().n_pairs, whole.view_size().n_pairs);
    EXPECT_EQ(splats.size() + splats.n_second, whole.view_size().n_splats);
  }
}

TEST(SplitView, RefusesTensorsThatDoNotFit) {
  const TestScene scene = smooth_scene();
  const RenderSettings settings = settings_of(scene);
  Rasterizer rasterizer(torch::kCPU);
  const ViewSplats good = rasterizer.project(scene.gaussians, scene.view, settings);
  const std::int64_t m = good.size();
  ASSERT_GT(m, 2);
  const auto render = [&](auto&& change) {
    ViewSplats splats = good;
    change(splats);
    rasterizer.forward_splats(splats, scene.view, settings);
  };
  EXPECT_TRUE(fails_with<LogicError>({"splats is [", ", 11]"}, [&] {
    render([](ViewSplats& s) { s.splats = s.splats.slice(1, 0, 11).contiguous(); });
  }));
  EXPECT_TRUE(fails_with<LogicError>({"splats is undefined"}, [&] { render([](ViewSplats& s) { s = {}; }); }));
  EXPECT_TRUE(fails_with<LogicError>({"extents is [", "expected ["},
                                     [&] { render([](ViewSplats& s) { s.extents = s.extents.slice(0, 1); }); }));
  EXPECT_TRUE(fails_with<LogicError>({"radii is Float", "expected Int"},
                                     [&] { render([](ViewSplats& s) { s.radii = s.radii.to(torch::kFloat32); }); }));
  EXPECT_TRUE(fails_with<LogicError>({"splats is not aligned"}, [&] {
    render([&](ViewSplats& s) { s.splats = torch::zeros({12 * m + 1}).slice(0, 1).view({m, 12}); });
  }));
  EXPECT_TRUE(fails_with<LogicError>({"camera"}, [&] {
    RenderSettings with_camera = settings;
    with_camera.camera_gradient = true;
    rasterizer.forward_splats(good, scene.view, with_camera);
  }));

  rasterizer.forward_splats(good, scene.view, settings);
  EXPECT_TRUE(fails_with<LogicError>({"error"}, [&] { rasterizer.score_splats(torch::zeros({1, 1})); }));
  const torch::Tensor sums = torch::zeros({m, 12}), scores = torch::zeros({m, 6}, torch::kInt32);
  const std::int64_t n = scene.gaussians.size();
  const SplatRecordTensors room{torch::zeros({m, 12}), torch::zeros({n}, torch::kInt32)};
  SplatOwner owner;
  const auto keep = [&](const torch::Tensor& some_sums, const SplatRecordTensors& some_room) {
    return [=, &owner, &good] { owner.keep(good, some_sums, n, some_room); };
  };
  EXPECT_TRUE(fails_with<LogicError>({"splat_grads"}, keep(sums.slice(0, 1), room)));
  EXPECT_TRUE(fails_with<LogicError>({"room for"}, keep(sums, {room.records.slice(0, 1), room.record_of_gaussian})));
  EXPECT_TRUE(fails_with<LogicError>({"record_of_gaussian"}, keep(sums, {room.records, torch::zeros({n})})));
  EXPECT_TRUE(fails_with<LogicError>({"scores"}, [&] { add_splat_scores(good, scores.slice(0, 1), make_scores(n)); }));
  EXPECT_TRUE(fails_with<LogicError>({"scores"}, [&] { add_splat_scores(good, sums, make_scores(n)); }));
}

TEST(SplitView, KeepsTheTwoKindsOfViewsApart) {
  const TestScene scene = smooth_scene();
  const RenderSettings settings = settings_of(scene);
  const RenderedViewGrad grad = uneven_grad(scene.view);
  const torch::Tensor error = uneven_error(scene.view);
  Rasterizer rasterizer(torch::kCPU);
  GaussianTensors grads;
  const auto expect_no_splats = [&] {
    EXPECT_TRUE(fails_with<LogicError>({"forward_splats()"}, [&] { rasterizer.backward_splats(grad); }));
    EXPECT_TRUE(fails_with<LogicError>({"forward_splats()"}, [&] { rasterizer.score_splats(error); }));
  };
  const auto expect_no_gaussians = [&] {
    EXPECT_THROW(rasterizer.backward(scene.gaussians, grad, grads), LogicError);
    EXPECT_THROW(rasterizer.score(error, make_scores(scene.gaussians.size())), LogicError);
  };
  expect_no_splats();
  rasterizer.forward(scene.gaussians, scene.view, settings);
  expect_no_splats();
  const ViewSplats splats = rasterizer.project(scene.gaussians, scene.view, settings);
  expect_no_splats();
  expect_no_gaussians();
  EXPECT_THROW(rasterizer.reblend(ForwardKernel::kSegmented), LogicError);
  EXPECT_THROW(rasterizer.count_load(), LogicError);
  rasterizer.forward_splats(splats, scene.view, settings);
  expect_no_gaussians();
  EXPECT_EQ(rasterizer.backward_splats(grad).size(0), splats.size());
  rasterizer.forward(scene.gaussians, scene.view, settings);
  expect_no_splats();
  rasterizer.backward(scene.gaussians, grad, grads);
}

}  // namespace
}  // namespace b3dgs::test
