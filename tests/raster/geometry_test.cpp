// Tests depth, normals and confidence of surfaces against the double-precision reference, and on scenes whose surface
// is known.
#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "core/check.h"
#include "raster/math/covariance.h"
#include "support/approx.h"
#include "support/expect_error.h"
#include "support/raster/geometry_check.h"

namespace b3dgs::test {
namespace {

class GeometryTest : public testing::TestWithParam<TestSceneRow> {};

TEST_P(GeometryTest, AgreesWithTheDenseReference) {
  const TestScene scene = GetParam().build();
  for (const auto& [culling, culling_name] : kCullings) {
    SCOPED_TRACE(culling_name);
    RenderSettings settings = settings_of(scene);
    settings.culling = culling;
    expect_same_surface<CpuView>(scene, settings);
  }
}

TEST_P(GeometryTest, AntialiasedAgreesWithTheDenseReference) {
  TestScene scene = GetParam().build();
  add_filters(scene);
  RenderSettings settings = settings_of(scene);
  settings.antialiasing = true;
  expect_same_surface<CpuView>(scene, settings);
}

INSTANTIATE_TEST_SUITE_P(Scenes, GeometryTest, testing::ValuesIn(test_scenes()),
                         [](const auto& info) { return std::string(info.param.name); });

SurfaceView surface_of(const TestScene& scene, const RenderSettings& settings, DepthKind kind = DepthKind::kSurface) {
  return CpuView(scene, settings).geometry(kind);
}

TEST(Geometry, IsTheSameForAnyKernelAndNumberOfThreads) {
  const TestScene scene = large_cloud();
  RenderSettings settings = settings_of(scene);
  for (const DepthKind kind : kDepthKinds) {
    settings.kernel = kStandardKernel;
    const SurfaceView expected = surface_of(scene, settings, kind);
    EXPECT_GT((expected.depth > 0).sum().item<std::int64_t>(), expected.depth.numel() / 20);
    for (const int threads : {1, 3, 7}) {
      const ScopedThreadCount scoped(threads);
      EXPECT_TRUE(is_same_surface(surface_of(scene, settings, kind), expected)) << threads << " threads";
    }
    for (const KernelRow& kernel : kForwardKernels) {
      settings.kernel = kernel.kernel;
      EXPECT_TRUE(is_same_surface(surface_of(scene, settings, kind), expected)) << kernel.name;
    }
  }
}

TEST(Geometry, DoesNotDependOnWhatElseIsRendered) {
  const TestScene scene = anisotropic_cloud();
  const SurfaceView expected = surface_of(scene, settings_of(scene));
  RenderSettings settings = settings_of(scene);
  settings.inverse_depth = true;
  settings.keep_for_backward = false;
  settings.background = {1, 0, 1};
  settings.sh_degree = 0;
  EXPECT_TRUE(is_same_surface(surface_of(scene, settings), expected));
}

TEST(Geometry, OfNothingIsZero) {
  for (const TestScene& scene : {empty_scene(), behind_the_camera()}) {
    for (const DepthKind kind : kDepthKinds) {
      const SurfaceView found = surface_of(scene, settings_of(scene), kind);
      for (const torch::Tensor& image : {found.depth, found.normal, found.confidence}) {
        EXPECT_TRUE(same(image, torch::zeros_like(image)));
      }
    }
  }
}

/// A wall of flat splats, dense and opaque, on a tilted plane in front of the camera.
struct Wall {
  static constexpr float kDistance = 3;  // of the plane from the camera
  Vec3f normal;                          // towards the camera
  TestScene scene;

  explicit Wall(const CameraView& view) {
    const Vec4<double> quat{0.25, 0.93, 0.2, -0.15};
    const Shape<double> shape = make_shape<double>({0, 0, 0}, quat);
    const auto axis = [&](int k) {
      const Mat3<double>& r = shape.rotation;
      return Vec3f{static_cast<float>(r(0, k)), static_cast<float>(r(1, k)), static_cast<float>(r(2, k))};
    };
    normal = axis(2);
    EXPECT_LT(normal.z, -0.7f);
    constexpr int kCount = 81;
    constexpr float kStep = 0.1f;
    std::vector<float> means;
    for (int i = 0; i < kCount * kCount; ++i) {
      const float u = kStep * static_cast<float>(i / kCount - kCount / 2);
      const float v = kStep * static_cast<float>(i % kCount - kCount / 2);
      const Vec3f at = u * axis(0) + v * axis(1) - kDistance * normal;
      means.insert(means.end(), {at.x, at.y, at.z});
    }
    const std::int64_t n = kCount * kCount;
    scene.gaussians = make_spheres(torch::tensor(means).view({n, 3}), torch::full({n}, 0.07f), torch::full({n}, 0.8f));
    scene.gaussians.log_scales.select(1, 2).fill_(-9);
    scene.gaussians.quats.copy_(torch::tensor({quat.x, quat.y, quat.z, quat.w}).to(torch::kFloat32));
    scene.view = view;
  }

  /// Compares the geometry of the pixels that ray_of(x, y) has a direction for. It is scaled so that t ray has depth t.
  template <class RayOf>
  void expect_seen(double tolerance, RayOf&& ray_of) const {
    const CameraView& view = scene.view;
    const double spread = tolerance / double{kConfidentSpread}, least_confidence = 0.95 / (1 + spread * spread);
    for (const DepthKind kind : {DepthKind::kSurface, DepthKind::kMedian}) {
      const SurfaceView found = surface_of(scene, settings_of(scene), kind);
      std::int64_t n_seen = 0;
      for (int y = 0; y < view.height; ++y) {
        for (int x = 0; x < view.width; ++x) {
          const double depth = found.depth[y][x].item<double>();
          if (depth == 0) continue;
          ++n_seen;
          const Vec3f ray = ray_of(static_cast<float>(x) + 0.5f, static_cast<float>(y) + 0.5f);
          const double expected = -double{kDistance} / dot(normal, ray);
          ASSERT_NEAR(depth, expected, tolerance * expected) << x << ", " << y;
          ASSERT_NEAR(found.normal[y][x][0].item<float>(), normal.x, 1e-4);
          ASSERT_NEAR(found.normal[y][x][2].item<float>(), normal.z, 1e-4);
          ASSERT_GT(found.confidence[y][x].item<double>(), least_confidence) << x << ", " << y;
        }
      }
      EXPECT_GT(n_seen, view.width * view.height / 10);
    }
  }
};

TEST(Geometry, OfAWallIsThatOfThePlane) {
  CameraView view = anisotropic_cloud().view;
  view.rotation = {{1, 0, 0, 0, 1, 0, 0, 0, 1}};
  view.translation = view.center = {0, 0, 0};
  Wall(view).expect_seen(1e-5, [&](float x, float y) {
    return Vec3f{(x - view.cx) / view.fx, (y - view.cy) / view.fy, 1};
  });
}

TEST(Geometry, OfAWallInAPanoramaIsItsDistance) {
  CameraView view = panorama().view;
  view.rotation = {{1, 0, 0, 0, 1, 0, 0, 0, 1}};
  view.translation = view.center = {0, 0, 0};
  constexpr double kBend = 0.02;  // 1 / distance is linear in the pixel only to first order
  Wall(view).expect_seen(kBend, [&](float x, float y) {
    const float longitude = (x - view.cx) / view.fx, latitude = (y - view.cy) / view.fy;
    return Vec3f{std::cos(latitude) * std::sin(longitude), std::sin(latitude),
                 std::cos(latitude) * std::cos(longitude)};
  });
}

TEST(Geometry, LeavesTheViewForABackwardPass) {
  const TestScene scene = anisotropic_cloud();
  const RenderedViewGrad grad = uneven_grad(scene.view);
  CpuView view(scene, settings_of(scene));
  const DenseGradients before = view.backward(grad);
  view.geometry(DepthKind::kSurface);
  EXPECT_TRUE(test::same(view.backward(grad).parameters.means, before.parameters.means));
}

TEST(Geometry, OfTheTorchLayerIsTheRasterizersAndNeedsItsGaussians) {
  const TestScene scene = odd_image_size();
  Rasterizer rasterizer(torch::kCPU);
  EXPECT_TRUE(fails_with<LogicError>({"geometry() before any forward"}, [&] { rasterizer.geometry(scene.gaussians); }));
  rasterizer.forward(scene.gaussians, scene.view, settings_of(scene));
  for (const DepthKind kind : kDepthKinds) {
    EXPECT_TRUE(
        is_same_surface(rasterizer.geometry(scene.gaussians, kind), surface_of(scene, settings_of(scene), kind)));
  }
  EXPECT_TRUE(is_same_surface(rasterizer.geometry(scene.gaussians),
                              surface_of(scene, settings_of(scene), DepthKind::kSurface)));
  EXPECT_TRUE(fails_with<LogicError>({"geometry() with 1 Gaussians after a forward() with"},
                                     [&] { rasterizer.geometry(one_splat().gaussians); }));
  const ViewSplats splats = rasterizer.project(scene.gaussians, scene.view, settings_of(scene));
  rasterizer.forward_splats(splats, scene.view, settings_of(scene));
  EXPECT_THROW(rasterizer.geometry(scene.gaussians), LogicError) << "it was given splats";
}

}  // namespace
}  // namespace b3dgs::test
