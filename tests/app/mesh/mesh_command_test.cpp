// b3dgs mesh, on the true Gaussians of a synthetic scene.
#include <gtest/gtest.h>

#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "model/formats/triangle_mesh.h"
#include "support/files.h"
#include "support/run_program.h"
#include "support/temp_dir.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using test::Outcome;
using test::run_b3dgs;

class MeshCommand : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder_ = new test::TempDir;
    const Outcome made = run_b3dgs({"synth", "orbit", path("scene"), "--points", "8000", "--views", "16", "--width",
                                    "160", "--height", "120", "--quiet"});
    ASSERT_EQ(made.exit_code, 0) << made.err;
  }
  static void TearDownTestSuite() { delete folder_; }

  static std::string path(const std::string& name) { return (*folder_ / name).string(); }
  static Outcome mesh(const std::string& output, const std::vector<std::string>& more = {}) {
    std::vector<std::string> words{"mesh", path("scene/truth.ply"), output, "-s", path("scene"), "--device", "cpu"};
    words.insert(words.end(), more.begin(), more.end());
    return run_b3dgs(words);
  }
  static void expect_refused(const Outcome& outcome, const std::string& error) {
    EXPECT_EQ(outcome.exit_code, 2) << outcome.out;
    EXPECT_NE(outcome.err.find(error), std::string::npos) << outcome.err;
  }

  static test::TempDir* folder_;
};
test::TempDir* MeshCommand::folder_ = nullptr;

TEST_F(MeshCommand, FindsTheSurfaceOfTheTruth) {
  const Outcome outcome =
      mesh(path("a.ply"), {"--compare", path("scene/truth_mesh.ply"), "--json", path("a.json"), "--views", "12"});
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  const TriangleMesh written = read_mesh_ply(path("a.ply"));
  const auto json = nlohmann::json::parse(test::read_bytes(path("a.json")));
  EXPECT_EQ(json["triangles"], written.triangles.size());
  EXPECT_EQ(json["views"], 12);
  EXPECT_EQ(json["non_manifold_edges"], 0);
  EXPECT_GT(json["comparison"]["f_score"], 0.7) << outcome.out;
  EXPECT_LT(json["comparison"]["accuracy"]["mean"], 2 * json["voxel"].get<double>()) << outcome.out;
  EXPECT_NE(test::read_bytes(path("a.ply")).find("property uchar red"), std::string::npos) << "from the photographs";
}

TEST_F(MeshCommand, WritesTheSameBytesWithAnyMemoryAndNumberOfThreads) {
  ASSERT_EQ(mesh(path("b.glb")).exit_code, 0);
  ASSERT_EQ(mesh(path("c.glb"), {"--memory_gb", "0.002", "--threads", "1"}).exit_code, 0);
  EXPECT_TRUE(test::read_bytes(path("b.glb")) == test::read_bytes(path("c.glb")));
  EXPECT_EQ(test::read_bytes(path("b.glb")).substr(0, 4), "glTF");
}

TEST_F(MeshCommand, ReducesTheNumberOfTriangles) {
  ASSERT_EQ(mesh(path("d.obj"), {"--faces", "10000", "--no_colors"}).exit_code, 0);
  const std::string text = test::read_bytes(path("d.obj"));
  std::size_t n_faces = 0;
  for (std::size_t at = text.find("\nf "); at != std::string::npos; at = text.find("\nf ", at + 1)) ++n_faces;
  EXPECT_GT(n_faces, 8000u);
  EXPECT_LT(n_faces, 12000u);
}

TEST_F(MeshCommand, RefusesWhatItCannotDoBeforeItRenders) {
  expect_refused(mesh(path("a.stl")), ".stl");
  expect_refused(run_b3dgs({"mesh", path("scene/truth.ply"), path("x.ply")}), "-s");
  expect_refused(run_b3dgs({"mesh", path("scene/truth.ply")}), "missing argument: OUTPUT");
  test::write_bytes(path("mine.ply"), "mine");
  expect_refused(mesh(path("mine.ply")), "exists; name another file, or replace it with --overwrite");
  EXPECT_EQ(test::read_bytes(path("mine.ply")), "mine");
  expect_refused(mesh(path("x.ply"), {"--views", "1"}), "expected at least 2 training views");
  expect_refused(mesh(path("x.ply"), {"--crop", "100,100,100,101,101,101"}), "contains no part of the surface");
  expect_refused(mesh(path("x.ply"), {"--far", "0.001"}), "no surface on which 2 neighbouring views agree");
  expect_refused(mesh(path("x.ply"), {"--compare", path("scene/truth.ply")}), "truth.ply");
  const std::string truth = path("scene/truth_mesh.ply"), bytes = test::read_bytes(truth);
  expect_refused(mesh(truth, {"--overwrite", "--compare", truth}), "is a file to read");
  expect_refused(mesh(path("scene/truth.ply"), {"--overwrite"}), "is a file to read");
  expect_refused(mesh(path("x.ply"), {"--json", path("mine.ply")}), "exists; name another file");
  expect_refused(mesh(path("x.ply"), {"--json", truth, "--overwrite", "--compare", truth}), "is a file to read");
  expect_refused(mesh(path("x.ply"), {"--json", path("x.ply")}), "is the file of the mesh");
  EXPECT_EQ(test::read_bytes(truth), bytes);
  EXPECT_EQ(test::read_bytes(path("mine.ply")), "mine");
  EXPECT_FALSE(fs::exists(path("x.ply"))) << "each is refused before anything is written";
}

}  // namespace
}  // namespace b3dgs
