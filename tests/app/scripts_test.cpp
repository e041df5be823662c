// Scripts that run the program.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>

#include "support/files.h"
#include "support/run_program.h"
#include "support/temp_dir.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using test::run_shell;

TEST(Demo, RefusesAFolderThatItDidNotMake) {
  const test::TempDir folder;
  test::write_bytes(folder / "mine/model/thesis.txt", "years");
  EXPECT_EQ(run_shell(folder.path(), B3DGS_SOURCE "/scripts/demo.sh '" + (folder / "mine").string() + "'"), 2);
  EXPECT_NE(test::read_bytes(folder / "out").find("holds something that the demo did not make"), std::string::npos);
  EXPECT_EQ(test::read_bytes(folder / "mine/model/thesis.txt"), "years");
}

TEST(ComparePresets, NamesProgramMachineAndCommitAboveItsTable) {
  const test::TempDir folder;
  const std::string run =
      R"({"scene": "fox", "scene_path": "/fox", "configuration": "a", "options": "", "iterations": 20, "seconds": 0.5, )"
      R"("gaussians": 1000, "psnr": 20.5, "ssim": 0.75, "seed": )";
  test::write_bytes(folder / "results/.made_by_compare_presets", "");
  test::write_bytes(folder / "results/results.jsonl",
                    run + "0}\n" + run + R"(1, "program": "b3dgs 1.2.3", "machine": "H200", "commit": "abc1234"})" +
                        "\n" + run + R"(2, "program": "b3dgs 1.2.3", "machine": "H200", "commit": null})" + "\n");
  const std::string command = B3DGS_SOURCE "/scripts/compare_presets.sh b3dgs '" + (folder / "results").string() + "'";
  EXPECT_EQ(run_shell(folder.path(), command), 0);
  const std::string out = test::read_bytes(folder / "out");
  EXPECT_EQ(
      out.rfind("Program: unknown, b3dgs 1.2.3. Machine: unknown, H200. Commit: unknown, abc1234.\n\n| scene |", 0), 0u)
      << out;
  EXPECT_NE(out.find("| fox | a | 20 | 3 | 0.50 ± 0.00 |"), std::string::npos) << out;
  EXPECT_EQ(out.find("colour-corrected"), std::string::npos) << out;
}

TEST(ComparePresets, HasColumnsOfWhatOnlySomeTrainingsMeasure) {
  const test::TempDir folder;
  const auto run = [](const std::string& configuration, const std::string& more) {
    return R"({"scene": "fox", "scene_path": "/fox", "configuration": ")" + configuration +
           R"(", "options": "", "iterations": 20, "seconds": 0.5, "gaussians": 1000, "psnr": 20.5, "ssim": 0.75, "seed": )" +
           more + "}\n";
  };
  test::write_bytes(folder / "results/.made_by_compare_presets", "");
  test::write_bytes(folder / "results/results.jsonl", run("a", "0") +
                                                          run("b", R"(0, "cc_psnr": 21, "whole_psnr": 19)") +
                                                          run("b", R"(1, "cc_psnr": 22, "whole_psnr": 19)"));
  const std::string command = B3DGS_SOURCE "/scripts/compare_presets.sh b3dgs '" + (folder / "results").string() + "'";
  EXPECT_EQ(run_shell(folder.path(), command), 0);
  const std::string out = test::read_bytes(folder / "out");
  EXPECT_NE(out.find("| SSIM | colour-corrected PSNR, dB | PSNR of whole views, dB |\n"), std::string::npos) << out;
  EXPECT_NE(out.find("| 0.7500 | - | - |\n"), std::string::npos) << out;
  EXPECT_NE(out.find("| 0.7500 ± 0.0000 | 21.50 ± 0.50 | 19.00 ± 0.00 |\n"), std::string::npos) << out;
}

TEST(ComparePresets, SaysHowFarEachIsBelowTheBestOfItsScene) {
  const test::TempDir folder;
  std::string runs;
  const auto add = [&](const std::string& scene, const std::string& configuration, int seed, const std::string& psnr) {
    runs += R"({"scene": ")" + scene + R"(", "scene_path": "/x", "configuration": ")" + configuration +
            R"(", "options": "", "iterations": 20, "seconds": 1, "gaussians": 10, "ssim": 0.75, "psnr": )" + psnr +
            R"(, "seed": )" + std::to_string(seed) + "}\n";
  };
  add("fox", "a", 0, "20"), add("fox", "a", 1, "21"), add("fox", "b", 0, "24"), add("fox", "c", 0, "null");
  add("lego", "a", 0, "30");
  test::write_bytes(folder / "results/.made_by_compare_presets", "");
  test::write_bytes(folder / "results/results.jsonl", runs);
  const std::string command = B3DGS_SOURCE "/scripts/compare_presets.sh b3dgs '" + (folder / "results").string() + "'";
  EXPECT_EQ(run_shell(folder.path(), command), 0);
  const std::string out = test::read_bytes(folder / "out");
  for (const char* end : {"| fox | a | 20 | 2 | 1.00 ± 0.00 | 10 ± 0 | 20.50 ± 0.50 | 3.50 |",
                          "| fox | b | 20 | 1 | 1.00 | 10 | 24.00 | 0.00 |", "| fox | c | 20 | 1 | 1.00 | 10 | - | - |",
                          "| lego | a | 20 | 1 | 1.00 | 10 | 30.00 | 0.00 |"}) {
    EXPECT_NE(out.find(end), std::string::npos) << out;
  }
}

TEST(ComparePresets, TakesTimesFromTrainingsThatRanAlone) {
  const test::TempDir folder;
  const auto run = [](const std::string& configuration, const std::string& more) {
    return R"({"scene": "fox", "scene_path": "/fox", "configuration": ")" + configuration +
           R"(", "options": "", "iterations": 20, "gaussians": 1000, "psnr": 20.5, "ssim": 0.75, )" + more + "}\n";
  };
  test::write_bytes(folder / "results/.made_by_compare_presets", "");
  test::write_bytes(folder / "results/results.jsonl", run("a", R"("seed": 0, "seconds": 4, "at_once": 1)") +
                                                          run("a", R"("seed": 1, "seconds": 9, "at_once": 2)") +
                                                          run("b", R"("seed": 0, "seconds": 9, "at_once": 2)"));
  const std::string command = B3DGS_SOURCE "/scripts/compare_presets.sh b3dgs '" + (folder / "results").string() + "'";
  EXPECT_EQ(run_shell(folder.path(), command), 0);
  const std::string out = test::read_bytes(folder / "out");
  EXPECT_NE(out.find("| fox | a | 20 | 2 | 4.00 | 1,000 ± 0 |"), std::string::npos) << out;
  EXPECT_NE(out.find("| fox | b | 20 | 1 | 9.00, 2 at once | 1,000 |"), std::string::npos) << out;
}

/// Replaces b3dgs train. Writes the files that the script reads, with the seed as count. Fails with the option --fail.
constexpr char kStandIn[] = R"(#!/usr/bin/env bash
set -eu
while (($# > 0)); do
  case $1 in
    -m) model=$2; shift ;;
    --seed) seed=$2; shift ;;
    --fail) exit 3 ;;
  esac
  shift
done
mkdir -p "$model/point_cloud"
echo '{"iterations": 20, "resolution": 1}' > "$model/config.json"
echo '{"iteration": 20, "elapsed_s": 1.5, "count": '$seed'}' > "$model/train.jsonl"
)";

TEST(ComparePresets, TrainsSeveralAtATimeOnceEach) {
  const test::TempDir folder;
  test::write_bytes(folder / "stand_in", kStandIn);
  fs::permissions(folder / "stand_in", fs::perms::owner_all);
  fs::create_directories(folder / "scene");
  const std::string at = "'" + folder.path().string() + "'";
  const auto compare = [&](const std::string& environment) {
    return run_shell(folder.path(), environment + " OPTIONS= " B3DGS_SOURCE "/scripts/compare_presets.sh " + at +
                                        "/stand_in " + at + "/results " + at + "/scene");
  };
  EXPECT_EQ(compare("JOBS=2.5 SEEDS=0 CONFIGS='a='"), 2);
  EXPECT_NE(test::read_bytes(folder / "out").find("JOBS: \"2.5\" is no number of trainings"), std::string::npos);
  EXPECT_EQ(compare("JOBS=2 SEEDS=4 CONFIGS='a=;a=--preset fast'"), 2);
  EXPECT_NE(test::read_bytes(folder / "out").find("two trainings would write"), std::string::npos);
  EXPECT_EQ(test::read_bytes(folder / "results/results.jsonl"), "");
  EXPECT_EQ(compare("JOBS=3 SEEDS='4 5 6 6' CONFIGS='a=;b=--preset fast'"), 0);
  const std::string out = test::read_bytes(folder / "out");
  EXPECT_NE(out.find("| scene | a | 20 | 3 | 1.50 ± 0.00, 3 at once | 5 ± 1 |"), std::string::npos) << out;
  EXPECT_NE(out.find("| scene | b | 20 | 3 | 1.50 ± 0.00, 3 at once | 5 ± 1 |"), std::string::npos) << out;
  const std::string results = test::read_bytes(folder / "results/results.jsonl");
  EXPECT_EQ(std::count(results.begin(), results.end(), '\n'), 6);
  EXPECT_FALSE(fs::exists(folder / "results/scene/a/seed_4/point_cloud")) << "models are deleted once measured";

  EXPECT_EQ(compare("LIMIT_S=0 SEEDS='4 7' CONFIGS='a='"), 3) << "no time for seed 7";
  EXPECT_EQ(compare("SEEDS='4 8' CONFIGS='a=;c=--fail'"), 1);
  const std::string after = test::read_bytes(folder / "results/results.jsonl");
  EXPECT_EQ(after.rfind(results, 0), 0u) << "trainings that are known are not repeated";
  EXPECT_EQ(after.find("\"c\""), std::string::npos) << after;
}

}  // namespace
}  // namespace b3dgs
