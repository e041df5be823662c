// b3dgs bench forecast.
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "support/files.h"
#include "support/run_program.h"
#include "support/temp_dir.h"

namespace b3dgs {
namespace {

using test::Outcome;
using test::run_b3dgs;

TEST(BenchForecast, ListsThePresetsAndWritesNoModel) {
  const test::TempDir folder;
  const std::string scene = (folder / "scene").string(), json = (folder / "forecast.json").string();
  ASSERT_EQ(run_b3dgs({"synth", "orbit", scene, "--points", "500", "--views", "8", "--width", "64", "--height", "48",
                       "--quiet"})
                .exit_code,
            0);
  test::RunOptions options;
  options.folder = folder.path();
  const Outcome run =
      run_b3dgs({"bench", "forecast", scene, "--steps", "50", "--device", "cpu", "--json", json}, options);
  ASSERT_EQ(run.exit_code, 0) << run.err;
  const nlohmann::json rows = nlohmann::json::parse(test::read_bytes(json))["presets"];
  ASSERT_EQ(rows.size(), 3u);
  int least = 0;
  for (const nlohmann::json& row : rows) {
    EXPECT_NE(run.out.find("\n" + row["preset"].get<std::string>() + " "), std::string::npos) << run.out;
    EXPECT_GE(row["iterations"], 50);
    EXPECT_GE(row["iterations"], least) << "fast, quality, best";
    least = row["iterations"];
    EXPECT_GT(row["n_gaussians"], 100);
    EXPECT_GT(row["train_s"], 0);
    EXPECT_GT(row["host_bytes"], 1000000);
    EXPECT_EQ(row["ply_bytes"], 248 * row["n_gaussians"].get<std::int64_t>());
  }
  int n_entries = 0;
  for (const auto& entry : std::filesystem::directory_iterator(folder.path())) n_entries += entry.exists();
  EXPECT_EQ(n_entries, 2) << "the scene and the JSON";
}

TEST(BenchForecast, NamesAMissingArgument) {
  const Outcome run = run_b3dgs({"bench", "forecast"});
  EXPECT_EQ(run.exit_code, 2);
  EXPECT_NE(run.err.find("missing argument: SOURCE_PATH"), std::string::npos) << run.err;
}

}  // namespace
}  // namespace b3dgs
