// Surfaces that are fused from ray-cast depth images. Lengths are in voxels.
#include "app/mesh/tsdf_volume.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>

#include "app/mesh/mesh_cleaning.h"
#include "app/mesh/mesh_distance.h"
#include "app/mesh/ray_cast_views.h"
#include "core/parallel.h"
#include "scene/cameras/camera_lens.h"
#include "support/expect_error.h"

namespace b3dgs {
namespace {

constexpr std::int64_t kAmple = std::int64_t{1} << 32;  // bytes
constexpr int kWidth = 320;
constexpr double kPixelsPerVoxel = 1.5;
constexpr std::int64_t kPoints = 200000;  // for comparisons

FusionSettings settings_for(const std::vector<DepthView>& views) {
  return {kPixelsPerVoxel * median_pixel_size(views), 4, kAmple};
}

TriangleMesh fuse_views(const std::vector<DepthView>& views, const FusionSettings& settings) {
  return fuse(views, blocks_near(views, settings), settings);
}

/// A cleaned mesh and its distance from the truth, in voxels.
struct Result {
  TriangleMesh mesh;
  Components components;
  MeshQuality quality;
};

MeshQuality compare_in_voxels(const TriangleMesh& mesh, const test::SolidScene& scene, double voxel) {
  MeshQuality quality = compare_meshes(mesh, scene.surface, scene.cameras, voxel, kPoints);
  for (SurfaceDistance* distance : {&quality.accuracy, &quality.completeness}) {
    distance->mean /= voxel;
    distance->p95 /= voxel;
  }
  return quality;
}

Result reconstruct(const test::SolidScene& scene, const test::DepthErrors& errors = {}) {
  std::vector<DepthView> views = test::ray_cast_views(scene, errors);
  const FusionSettings settings = settings_for(views);
  keep_consistent(views);
  Result result;
  result.mesh = fuse_views(views, settings);
  result.components = remove_small_components(result.mesh, 0.01);
  result.quality = compare_in_voxels(result.mesh, scene, settings.voxel);
  return result;
}

bool is_same(const TriangleMesh& a, const TriangleMesh& b) {
  return a.triangles == b.triangles && a.positions.size() == b.positions.size() &&
         std::memcmp(a.positions.data(), b.positions.data(), sizeof(Vec3f) * a.positions.size()) == 0;
}

/// Returns six times the volume inside.
double signed_volume(const TriangleMesh& mesh) {
  double sum = 0;
  for (const TriangleMesh::Triangle& t : mesh.triangles) sum += dot(mesh.position(t[0]), mesh.area_normal(t));
  return sum;
}

/// Makes a view that looks along +z at a wall, whose distance is a multiple of the voxel.
DepthView wall_view(double depth) {
  Camera camera = Camera::with_field_of_view(64, 48, 50, {});
  std::vector<float> normals;
  for (int i = 0; i < 64 * 48; ++i) normals.insert(normals.end(), {0, 0, -1});
  return make_depth_view(camera, std::vector<float>(64 * 48, static_cast<float>(depth)), normals.data(), 100);
}

TEST(Tsdf, OpenSceneIsAccurate) {
  const Result result = reconstruct(test::open_scene(kWidth));
  EXPECT_LE(result.quality.accuracy.mean, 0.05);
  EXPECT_LE(result.quality.completeness.mean, 0.10);
  EXPECT_GE(result.quality.f_score(), 0.985);
  EXPECT_LE(result.quality.accuracy.degrees, 2.5);
  EXPECT_EQ(count_edges(result.mesh).non_manifold_edges, 0u);
}

TEST(Tsdf, ClosedSceneIsWatertight) {
  const Result result = reconstruct(test::closed_scene(kWidth));
  EXPECT_GE(result.quality.f_score(), 0.995);
  const Topology topology = count_edges(result.mesh);
  EXPECT_EQ(topology.boundary_edges, 0u);
  EXPECT_EQ(topology.non_manifold_edges, 0u);
  EXPECT_EQ(result.components.kept, 2u);
  EXPECT_GT(signed_volume(result.mesh), 0) << "faces must point outward";
}

TEST(Tsdf, NoiseAndFloatersAverageOut) {
  const Result result = reconstruct(test::open_scene(kWidth), test::kUsualErrors);
  EXPECT_LE(result.quality.accuracy.mean, 0.09);
  EXPECT_LE(result.quality.completeness.mean, 0.13);
  EXPECT_GE(result.quality.f_score_of_half(), 0.97);
  EXPECT_LE(result.quality.accuracy.degrees, 5);
  EXPECT_EQ(result.components.kept, 3u);
}

TEST(Tsdf, DecimationKeepsTheSurface) {
  const test::SolidScene scene = test::open_scene(kWidth);
  Result full = reconstruct(scene, test::kUsualErrors);
  TriangleMesh coarse = full.mesh;
  const std::size_t n = full.mesh.triangles.size() / 4;
  decimate(coarse, n);
  EXPECT_LE(coarse.triangles.size(), n + n / 50);
  split_non_manifold(coarse);
  EXPECT_EQ(count_edges(coarse).non_manifold_edges, 0u);
  const double voxel = settings_for(test::ray_cast_views(scene, test::kUsualErrors)).voxel;
  EXPECT_LE(compare_in_voxels(coarse, scene, voxel).accuracy.mean, full.quality.accuracy.mean + 0.02);
}

TEST(Tsdf, SameBytesForAnyThreadsAndMemory) {
  std::vector<DepthView> views = test::ray_cast_views(test::open_scene(160), test::kUsualErrors);
  const FusionSettings ample = settings_for(views);
  TriangleMesh expected;
  for (const int threads : {1, 2, 7}) {
    set_thread_count(threads);
    std::vector<DepthView> kept = views;
    keep_consistent(kept);
    const TriangleMesh mesh = fuse_views(kept, ample);
    if (threads == 1) expected = mesh;
    EXPECT_TRUE(is_same(mesh, expected)) << threads << " threads";
  }
  set_thread_count(0);
  keep_consistent(views);
  EXPECT_GT(expected.triangles.size(), 10000u);
  for (const std::int64_t memory : {16000000, 2000000, 0}) {
    const FusionSettings limited{ample.voxel, ample.truncation, memory};
    EXPECT_TRUE(is_same(fuse_views(views, limited), expected)) << memory << " bytes";
  }
}

// Voxels exactly on the surface have a distance of 0, and behind it is another surface towards the unseen voxels.
TEST(Tsdf, WallOnVoxelsIsOneSheet) {
  const double voxel = 1.0 / 32, depth = 2;
  const std::vector<DepthView> views{wall_view(depth)};
  const FusionSettings settings{voxel, 4, kAmple};
  TriangleMesh mesh = fuse_views(views, settings);
  ASSERT_FALSE(mesh.triangles.empty());
  for (const Vec3f& position : mesh.positions) EXPECT_NEAR(position.z, depth, 0.01 * voxel);
  for (const TriangleMesh::Triangle& triangle : mesh.triangles) EXPECT_LT(mesh.area_normal(triangle).z, 0);
  EXPECT_TRUE(is_same(fuse_views(views, {voxel, 4, 0}), mesh)) << "in cubes";
  EXPECT_EQ(count_edges(mesh).non_manifold_edges, 0u);
  EXPECT_EQ(remove_small_components(mesh, 0).kept, 1u);
}

TEST(Tsdf, FusesPanoramas) {
  test::SolidScene scene = test::closed_scene(kWidth);
  for (Camera& camera : scene.cameras) {
    const Pose pose = camera.cam_from_world;
    camera = panorama_camera({800, 400});
    camera.cam_from_world = pose;
  }
  const Result result = reconstruct(scene);
  EXPECT_LE(result.quality.accuracy.mean, 0.13);  // measured: 0.114
  EXPECT_GE(result.quality.f_score(), 0.98);
}

TEST(Tsdf, SmallVoxelsAreRefused) {
  const std::vector<DepthView> views{wall_view(2)};
  EXPECT_TRUE(test::fails_with<InputError>({"--voxel", "or more"}, [&] { blocks_near(views, {1e-6, 4, kAmple}); }));
}

TEST(Tsdf, NoDepthGivesNoSurface) {
  std::vector<DepthView> views{wall_view(0), wall_view(0)};
  EXPECT_EQ(median_pixel_size(views), 0);
  EXPECT_EQ(keep_consistent(views), 0);
  EXPECT_TRUE(fuse_views(views, {0.1, 4, kAmple}).triangles.empty());
}

TEST(DepthViews, InconsistentDepthsAreRemoved) {
  std::vector<DepthView> views = test::ray_cast_views(test::open_scene(160));
  DepthView& view = views[7];
  const std::size_t wrong = view.index(80, 60), right = view.index(80, 90);
  ASSERT_GT(view.depth[right], 0);
  view.depth[wrong] = 1;
  view.cosine[wrong] = kCosineLevels;
  const float before = view.depth[right];
  EXPECT_GT(keep_consistent(views), 0.9);
  EXPECT_EQ(view.depth[wrong], 0);
  EXPECT_EQ(view.depth[right], before);
}

TEST(DepthViews, GrazingAndFarDepthsAreNotUsed) {
  const Camera camera = Camera::with_field_of_view(3, 1, 50, {});
  const float normals[9] = {0, 0, -1, 0.99f, 0, -0.14f, 0, 0, -1};
  const DepthView view = make_depth_view(camera, {2, 2, 5}, normals, 4);
  EXPECT_EQ(view.depth, (std::vector<float>{2, 0, 0}));
}

}  // namespace
}  // namespace b3dgs
