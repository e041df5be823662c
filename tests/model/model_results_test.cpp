// Results of evaluations that finish at the same time.
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>
#include <string>

#include "core/files/own_files.h"
#include "model/model_folder.h"
#include "support/expect_error.h"
#include "support/files.h"
#include "support/processes.h"
#include "support/temp_dir.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

TEST(ModelResults, OfEvaluationsAtTheSameTimeAreAllKept) {
  constexpr int kProcesses = 4, kEach = 10;
  test::TempDir temp;
  const ModelFolder folder(temp.path());
  test::run_processes(kProcesses, [&](int process) {
    const OwnFiles own(temp.path());
    for (int i = 0; i < kEach; ++i) {
      const int iteration = process * kEach + i + 1;
      folder.write_results("ours_" + std::to_string(iteration), {{}, {static_cast<double>(iteration), 0.5}}, {});
    }
  });
  const auto results = nlohmann::json::parse(test::read_bytes(temp / "results.json"));
  EXPECT_EQ(results.size(), kProcesses * kEach);
  EXPECT_EQ(nlohmann::json::parse(test::read_bytes(temp / "per_view.json")).size(), kProcesses * kEach);
  for (int i = 1; i <= kProcesses * kEach; ++i) EXPECT_EQ(results.at("ours_" + std::to_string(i)).at("PSNR"), i);
  for (const auto& entry : fs::directory_iterator(temp.path())) {
    EXPECT_EQ(entry.path().string().find(".previous"), std::string::npos) << entry.path();
  }
}

TEST(ModelResults, WithTheSameKeyTwiceAreNotReplaced) {
  test::TempDir temp;
  const std::string text = R"({"ours_5": {"PSNR": 1}, "ours_5": {"PSNR": 2}})";
  test::write_bytes(temp / "results.json", text);
  EXPECT_TRUE(test::fails_with<InputError>({"results.json", "\"ours_5\" twice"}, [&] {
    ModelFolder(temp.path()).write_results("ours_7", {{}, {20, 0.5}}, {});
  }));
  EXPECT_EQ(test::read_bytes(temp / "results.json"), text);
}

}  // namespace
}  // namespace b3dgs
