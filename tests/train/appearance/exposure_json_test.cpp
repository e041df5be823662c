// Tests reading and writing of exposure.json.
#include "train/appearance/appearance_model.h"

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "core/check.h"
#include "support/expect_error.h"
#include "support/files.h"
#include "support/temp_dir.h"
#include "support/train/tiny_scene.h"

namespace b3dgs {
namespace {

TEST(ExposureJson, HoldsTheRowsByName) {
  Scene scene = test::make_tiny_scene();
  torch::manual_seed(1);
  const auto n_views = static_cast<std::int64_t>(scene.train.size());
  const torch::Tensor exposures = torch::randn({n_views, 3, 4});
  const test::TempDir temp;
  const Exposures named = named_exposures(exposures, scene.train);
  write_exposures(temp / "exposure.json", named);
  EXPECT_EQ(read_exposures(temp / "exposure.json"), named);
  const auto json = nlohmann::json::parse(test::read_bytes(temp / "exposure.json"));
  ASSERT_EQ(json.size(), scene.train.size());
  for (std::int64_t i = 0; i < n_views; ++i) {
    const auto& rows = json.at(scene.train[static_cast<std::size_t>(i)].name);
    ASSERT_EQ(rows.size(), 3u);
    for (std::int64_t row = 0; row < 3; ++row) {
      ASSERT_EQ(rows[static_cast<std::size_t>(row)].size(), 4u);
      for (std::int64_t k = 0; k < 4; ++k) {
        EXPECT_EQ(rows[static_cast<std::size_t>(row)][static_cast<std::size_t>(k)].get<float>(),
                  exposures[i][row][k].item<float>());
      }
    }
  }
  scene.train[0].name = "caf\xe9.png";  // not UTF-8
  scene.train[1].name = "caf\xe8.png";
  const Exposures of_bytes = named_exposures(exposures, scene.train);
  write_exposures(temp / "exposure.json", of_bytes);
  EXPECT_EQ(read_exposures(temp / "exposure.json"), of_bytes);
}

TEST(ExposureJson, DamagedFilesAreRefused) {
  const test::TempDir temp;
  const auto refused = [&](const std::string& text, const std::string& part) {
    test::write_bytes(temp / "exposure.json", text);
    return test::fails_with<InputError>({"exposure.json", part}, [&] { read_exposures(temp / "exposure.json"); });
  };
  EXPECT_TRUE(refused("", "not a JSON object"));
  EXPECT_TRUE(refused("[1, 2]", "not a JSON object"));
  EXPECT_TRUE(refused(R"({"a.png": 1})", "a.png: expected 3 rows of 4 numbers, found 1"));
  EXPECT_TRUE(refused(R"({"a.png": [[1, 0, 0, 0], [0, 1, 0, 0]]})", "3 rows"));
  EXPECT_TRUE(refused(R"({"a.png": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1]]})", "3 rows"));
  EXPECT_TRUE(refused(R"({"a.png": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0, 5]]})", "3 rows"));
  EXPECT_TRUE(refused(R"({"a.png": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, "x", 0]]})", "3 rows"));
  EXPECT_TRUE(refused(R"({"a.png": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]})", "3 rows"));
  EXPECT_TRUE(
      test::fails_with<InputError>({"none.json: cannot be opened"}, [&] { read_exposures(temp / "none.json"); }));
}

}  // namespace
}  // namespace b3dgs
