// b3dgs bench step.
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "raster/stages.h"
#include "support/files.h"
#include "support/run_program.h"
#include "support/temp_dir.h"

namespace b3dgs {
namespace {

using test::Outcome;
using test::run_b3dgs;

class BenchStep : public ::testing::Test {
 protected:
  BenchStep() {
    const Outcome made = run_b3dgs({"synth", "orbit", path("scene"), "--points", "500", "--views", "6", "--width", "48",
                                    "--height", "32", "--quiet"});
    EXPECT_EQ(made.exit_code, 0) << made.err;
  }
  std::string path(const std::string& name) const { return (folder_ / name).string(); }
  nlohmann::json bench(std::vector<std::string> words) const {
    const std::vector<std::string> common{"bench", "step",     "--device", "cpu",    "--steps",
                                          "4",     "--warmup", "2",        "--json", path("step.json")};
    words.insert(words.begin(), common.begin(), common.end());
    test::RunOptions options;
    options.folder = folder_.path();
    const Outcome run = run_b3dgs(words, options);
    EXPECT_EQ(run.exit_code, 0) << run.err;
    EXPECT_NE(run.out.find("blend_backward"), std::string::npos) << run.out;
    return nlohmann::json::parse(test::read_bytes(path("step.json")));
  }

  test::TempDir folder_;
};

TEST_F(BenchStep, TimesEveryStageAndWritesNoModel) {
  // Preset inria, because only its schedule has "densify" here.
  const nlohmann::json report =
      bench({path("scene"), "--kernel", "combined", "--culling", "square", "--preset", "inria"});
  std::vector<std::string> names;
  double share = 0;
  for (const nlohmann::json& row : report["stages"]) {
    names.push_back(row["stage"]);
    EXPECT_LE(row["min_ms"], row["median_ms"]) << row;
    EXPECT_LE(row["median_ms"], row["max_ms"]) << row;
    if (row["stage"] != "step") share += row["share"].get<double>();
  }
  std::vector<std::string> expected(kStageNames.begin(), kStageNames.end());
  expected.insert(expected.end(), {"host", "step"});
  EXPECT_EQ(names, expected);
  EXPECT_NEAR(share, 1, 1e-6);
  EXPECT_GT(report["wall_ms"].get<double>(), 0);
  EXPECT_EQ(report["config"]["culling"], "square");
  EXPECT_GT(report["n_gaussians"].get<int>(), 100);
  int n_entries = 0;
  for (const auto& entry : std::filesystem::directory_iterator(folder_.path())) n_entries += entry.exists();
  EXPECT_EQ(n_entries, 2) << "the scene and the report";
}

TEST_F(BenchStep, StartsFromACheckpointAndTimesDensityControl) {
  const Outcome trained =
      run_b3dgs({"train", "-s", path("scene"), "-m", path("model"), "--iterations", "11", "--sh_degree", "1",
                 "--preset", "inria", "--densify_from_iter", "1", "--densification_interval", "5", "--quiet"});
  ASSERT_EQ(trained.exit_code, 0) << trained.err;
  const nlohmann::json report = bench({"--checkpoint", path("model/checkpoints/iteration_11.b3dgs")});
  EXPECT_EQ(report["config"]["sh_degree"], 1);
  EXPECT_EQ(report["density_rounds"]["count"], 1) << "12 and 13 are warm-up, 14 to 17 are timed";
}

TEST_F(BenchStep, AcceptsButDoesNotListOptionsWithoutEffect) {
  EXPECT_EQ(bench({path("scene"), "-m", path("model")})["steps"], 4);
  EXPECT_FALSE(std::filesystem::exists(path("model")));
  const std::string help = run_b3dgs({"bench", "step", "--help"}).out;
  EXPECT_NE(help.find("--source_path"), std::string::npos) << help;
  EXPECT_EQ(help.find("--model_path"), std::string::npos) << help;
  EXPECT_EQ(help.find("--save_iterations"), std::string::npos) << help;
}

TEST_F(BenchStep, NamesAMissingArgument) {
  const Outcome nothing = run_b3dgs({"bench", "step"});
  EXPECT_EQ(nothing.exit_code, 2);
  EXPECT_NE(nothing.err.find("missing argument: SOURCE_PATH"), std::string::npos) << nothing.err;
}

}  // namespace
}  // namespace b3dgs
