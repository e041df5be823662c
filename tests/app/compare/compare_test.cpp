// b3dgs compare and its reports, run as a program.
#include <gtest/gtest.h>

#include <algorithm>
#include <csignal>
#include <fstream>
#include <nlohmann/json.hpp>
#include <set>

#include "app/compare/interleaved_training.h"
#include "support/files.h"
#include "support/page_data.h"
#include "support/run_program.h"
#include "support/same.h"
#include "support/temp_dir.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;
using test::Outcome;
using test::read_bytes;
using test::run_b3dgs;
using Words = std::vector<std::string>;

class Compare : public ::testing::Test {
 protected:
  Compare() {
    const Outcome made = run_b3dgs(
        {"synth", "orbit", scene(), "--points", "600", "--views", "10", "--width", "64", "--height", "48", "--quiet"});
    EXPECT_EQ(made.exit_code, 0) << made.err;
  }

  std::string scene() const { return (folder_.path() / "scene").string(); }
  fs::path output(const std::string& name = "out") const { return folder_.path() / name; }

  Outcome compare(const Words& more, const std::string& name = "out", const test::RunOptions& options = {}) const {
    Words words{"compare", scene(), "-m", output(name).string(), "--configs", "naive,sub-tile", "--device", "cpu"};
    words.insert(words.end(), more.begin(), more.end());
    return run_b3dgs(words, options);
  }

  json result(const std::string& name = "out") const { return json::parse(read_bytes(output(name) / "compare.json")); }
  std::string page(const std::string& name = "out") const { return read_bytes(output(name) / "report.html"); }
  json page_data() const { return test::data_of_page(page()); }

  test::TempDir folder_;
};

TEST_F(Compare, TrainsAllInTurnsAndReports) {
  const Outcome outcome = compare({"--iterations", "60", "--chunk", "25", "--test_iterations", "20", "40"});
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  EXPECT_NE(outcome.out.find("configuration"), std::string::npos) << outcome.out;
  const json result = this->result();
  EXPECT_EQ(result["plan"]["configs"], "naive,sub-tile");
  EXPECT_EQ(result["summary"]["done"], 60);
  EXPECT_FALSE(result["machine"]["program"].get<std::string>().empty());
  ASSERT_EQ(result["runs"].size(), 2u);
  for (const json& run : result["runs"]) {
    EXPECT_EQ(run["curves"]["iteration"], (std::vector<int>{10, 20, 30, 40, 50, 60}));
    EXPECT_GT(run["curves"]["elapsed_s"].back().get<double>(), 0);
    EXPECT_GT(run["curves"]["test_psnr"].back().get<double>(), 8);
    EXPECT_TRUE(fs::exists(output() / run["folder"].get<std::string>() / "point_cloud/iteration_60/point_cloud.ply"));
    EXPECT_TRUE(fs::exists(output() / run["folder"].get<std::string>() / "report.html"));
  }
  // All kernels compute the same images, so both trainings have the same loss.
  const auto loss = [&](int run) { return result["runs"][run]["curves"]["loss"].back().get<double>(); };
  EXPECT_NEAR(loss(0), loss(1), 0.02 * loss(0));
  for (const fs::directory_entry& entry : fs::directory_iterator(output())) {
    EXPECT_EQ(entry.path().string().find(".tmp"), std::string::npos) << entry.path();
  }

  const json shown = page_data();
  EXPECT_EQ(shown["summary"]["verdict"], result["summary"]["verdict"]);
  EXPECT_EQ(shown["previews"][0]["renders"][1]["image"].get<std::string>().find("data:image/jpeg"), 0u);
  EXPECT_EQ(shown["runs"][0]["kernel_checks"], json::array()) << "no kernels were timed";
  const json config = json::parse(read_bytes(output() / "naive/seed_0/config.json"));
  EXPECT_EQ(config["gpu_memory_gb"], 0) << "shares of this machine's memory are not stored as options";
}

TEST_F(Compare, StoppedAndResumedGivesTheSameCurves) {
  const Words length{"--iterations", "60", "--chunk", "7", "--checkpoint_iterations", "10,20,30,40,50", "--quiet"};
  ASSERT_EQ(compare(length, "whole").exit_code, 0);
  test::RunOptions options;
  options.signal = SIGTERM;
  options.signal_when = [&] { return fs::exists(output() / "naive/seed_0/checkpoints/iteration_20.b3dgs"); };
  const Outcome stopped = compare(length, "out", options);
  ASSERT_EQ(stopped.exit_code, 143) << stopped.out << stopped.err;
  EXPECT_NE(stopped.out.find("--resume"), std::string::npos);
  EXPECT_EQ(page().compare(0, 9, "<!DOCTYPE"), 0);
  EXPECT_EQ(page_data()["summary"]["verdict"].get<std::string>().find("Not finished"), 0u);
  const Outcome resumed = run_b3dgs({"compare", "--resume", "-m", output().string(), "--quiet"});
  ASSERT_EQ(resumed.exit_code, 0) << resumed.err;

  const json whole = result("whole"), parts = result();
  for (const int run : {0, 1}) {
    for (const char* figure : {"iteration", "loss", "count", "test_psnr", "test_ssim"}) {
      EXPECT_EQ(whole["runs"][run]["curves"][figure], parts["runs"][run]["curves"][figure]) << run << " " << figure;
    }
  }
  const fs::path ply = "sub-tile/seed_0/point_cloud/iteration_60/point_cloud.ply";
  EXPECT_TRUE(test::same(read_bytes(output("whole") / ply), read_bytes(output() / ply)));

  const Outcome again = run_b3dgs({"compare", "--resume", "-m", output().string(), "--quiet"});
  EXPECT_EQ(again.exit_code, 0) << "everything is trained, only the report is written again; " << again.err;
  EXPECT_EQ(result()["runs"], parts["runs"]);
}

TEST_F(Compare, SuggestsFewerIterationsOnACpuUnlessTheyWereChosen) {
  const std::string hint = "training on a CPU: 3,200 iterations of each of 2 configurations take long; --iterations";
  test::RunOptions stop;
  stop.signal = SIGTERM;
  stop.signal_when = [&] { return fs::exists(output() / "naive/seed_0/train.jsonl"); };
  const Outcome by_default = compare({"--max_epochs", "400"}, "out", stop);
  EXPECT_EQ(by_default.exit_code, 143) << by_default.err;
  EXPECT_LT(by_default.err.find(hint), by_default.err.find("loading images")) << by_default.err;
  const Outcome chosen = compare({"--iterations", "10"}, "chosen");
  ASSERT_EQ(chosen.exit_code, 0) << chosen.err;
  EXPECT_EQ(chosen.err.find("take long"), std::string::npos) << chosen.err;
  const Outcome by_entry = compare({"--configs", "a:iterations=10,b:iterations=20"}, "by_entry");
  ASSERT_EQ(by_entry.exit_code, 0) << by_entry.err;
  EXPECT_EQ(by_entry.err.find("take long"), std::string::npos) << by_entry.err;
}

TEST_F(Compare, ConfigurationsMayDifferInPresetAndLength) {
  const std::string configs = "long:preset=inria+iterations=40,fast:preset=fast+iterations=20+antialiasing=true";
  const Words options{"--configs", configs, "--kernel", "sub-tile", "--chunk", "15", "--quiet"};
  test::RunOptions stop;
  stop.signal = SIGTERM;
  stop.signal_when = [&] { return fs::exists(output() / "fast/seed_0/point_cloud/iteration_20/point_cloud.ply"); };
  const Outcome stopped = compare(options, "out", stop);
  ASSERT_TRUE(stopped.exit_code == 143 || stopped.exit_code == 0) << stopped.out << stopped.err;
  const Outcome resumed = run_b3dgs({"compare", "--resume", "-m", output().string(), "--quiet"});
  ASSERT_EQ(resumed.exit_code, 0) << resumed.err;
  EXPECT_NE(resumed.out.find("at the end of"), std::string::npos) << resumed.out;
  const json result = this->result();
  EXPECT_EQ(result["plan"]["given"]["kernel"], "sub-tile");
  EXPECT_EQ(result["summary"]["iterations"], 40);
  ASSERT_EQ(result["summary"]["results"].size(), 2u);
  EXPECT_EQ(result["summary"]["results"][0]["iterations"], 40);
  EXPECT_EQ(result["summary"]["results"][1]["iterations"], 20);
  for (const json& own : result["summary"]["results"]) {
    EXPECT_EQ(own["complete_seeds"], 1);
    EXPECT_GT(own["psnr"]["mean"].get<double>(), 5);
  }
  EXPECT_EQ(result["runs"][0]["curves"]["iteration"].back(), 40);
  EXPECT_EQ(result["runs"][1]["curves"]["iteration"].back(), 20);
  EXPECT_EQ(page_data()["summary"]["results"].size(), 2u);
  const json fast = json::parse(read_bytes(output() / "fast/seed_0/config.json"));
  EXPECT_EQ(fast["preset"], "fast");
  EXPECT_EQ(fast["position_lr_max_steps"], 20);
  EXPECT_EQ(fast["lenses"], "undistort") << "for anti-aliasing, and so for all";
}

TEST_F(Compare, NoiseMeasuresTheRunToRunVariation) {
  const Outcome outcome =
      compare({"--iterations", "20", "--noise", "--quiet", "--configs", "naive-kernels,sub-tile,adaptive"});
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  const json result = this->result();
  ASSERT_EQ(result["runs"].size(), 4u);
  EXPECT_EQ(result["runs"][3]["configuration"], "naive-kernels_again");
  EXPECT_EQ(result["summary"]["repetition"], "naive-kernels_again");
  EXPECT_TRUE(result["summary"]["machine_spread"].is_number());
  EXPECT_EQ(result["runs"][0]["curves"]["loss"], result["runs"][3]["curves"]["loss"])
      << "the same configuration and seed";
  EXPECT_NE(outcome.out.find("\nnaive-kernels_again "), std::string::npos) << outcome.out;
  EXPECT_NE(outcome.out.find("too short"), std::string::npos)
      << "the baseline does not differ from itself; " << outcome.out;
  EXPECT_EQ(page_data()["summary"]["repetition"], "naive-kernels_again");

  ASSERT_EQ(compare({"--iterations", "5", "--quiet"}, "without").exit_code, 0);
  const Outcome more = run_b3dgs({"compare", "--resume", "-m", output("without").string(), "--noise"});
  EXPECT_EQ(more.exit_code, 2);
  EXPECT_NE(more.err.find("--resume cannot change --noise (the comparison was started without it)"), std::string::npos)
      << more.err;
}

TEST(FirstInTurn, RotatesOverTurnsAndSeeds) {
  for (const std::size_t n : {2u, 3u, 5u}) {
    std::set<std::size_t> of_turns, of_seeds;
    for (std::size_t i = 0; i < n; ++i) {
      of_turns.insert(first_in_turn(0, static_cast<int>(i), n));
      of_seeds.insert(first_in_turn(i, 0, n));
    }
    EXPECT_EQ(of_turns.size(), n);
    EXPECT_EQ(of_seeds.size(), n);
  }
}

TEST_F(Compare, SeveralSeedsGiveARange) {
  const Outcome outcome = compare({"--iterations", "20", "--kernel_check_interval", "10", "--seeds", "3", "5",
                                   "--quiet", "--configs", "naive,adaptive"});
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  const json result = this->result();
  ASSERT_EQ(result["runs"].size(), 4u);
  EXPECT_EQ(result["summary"]["compared"][0]["saved_overall"]["n"], 2);
  EXPECT_TRUE(fs::exists(output() / "naive/seed_5/train.jsonl"));
  EXPECT_EQ(result["summary"]["ours"], "adaptive");
  EXPECT_TRUE(result["runs"][0]["kernel_checks"].empty()) << "a fixed kernel";
  const json& checks = result["runs"][3]["kernel_checks"];
  ASSERT_EQ(checks.size(), 2u);
  EXPECT_EQ(checks[0]["iteration"], 6);
  EXPECT_EQ(checks[1]["iteration"], 16);
  for (const char* kernel : {"segmented", "sub-tile"}) {
    EXPECT_GT(checks[1]["times_ms"][kernel].get<double>(), 0) << kernel;
  }
  EXPECT_EQ(page_data()["runs"][3]["kernel_checks"].size(), 2u);
}

TEST_F(Compare, RepeatsTheComparisonOfThePaper) {
  const Outcome outcome =
      compare({"--iterations", "20", "--kernel_check_interval", "10", "--quiet", "--configs", "paper"});
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  EXPECT_NE(outcome.out.find("\npublished against naive-kernels "), std::string::npos) << outcome.out;
  EXPECT_NE(outcome.out.find("\nin the paper "), std::string::npos) << outcome.out;
  const json summary = result()["summary"];
  EXPECT_EQ(summary["baseline"], "naive-kernels");
  ASSERT_EQ(summary["beside_paper"].size(), 1u);
  EXPECT_EQ(summary["beside_paper"][0]["name"], "published");
  const json checks = result()["runs"][1]["kernel_checks"];
  ASSERT_EQ(checks.size(), 2u);
  EXPECT_TRUE(checks[0]["times_ms"].contains("combined") && checks[0]["times_ms"].contains("shared-memory")) << checks;
}

TEST_F(Compare, RejectsInvalidOptionsBeforeAnythingIsWritten) {
  const auto rejected = [&](const Words& words, const std::string& reason) {
    const Outcome outcome = compare(words);
    EXPECT_EQ(outcome.exit_code, 2) << outcome.out;
    EXPECT_NE(outcome.err.find(reason), std::string::npos) << outcome.err;
    EXPECT_FALSE(fs::exists(output()));
  };
  rejected({"--configs", "naive,fastest"},
           "--configs fastest: unknown configuration \"fastest\" (expected naive, dynamic, gaussian-wise, ");
  rejected({"--configs", "naive,naive"}, "occurs twice");
  rejected({"--configs", "naive"}, "at least two configurations");
  rejected({"--seeds", "1", "1"}, "occurs twice");
  rejected({"--chunk", "0"}, "invalid value for --chunk (expected at least 1");
  rejected({"--resume"}, "no comparison to resume");
  EXPECT_EQ(run_b3dgs({"compare"}).exit_code, 2);
}

TEST_F(Compare, RejectsTheFolderOfAModel) {
  const std::string model = output("model").string();
  ASSERT_EQ(
      run_b3dgs({"train", "-s", scene(), "-m", model, "--iterations", "2", "--device", "cpu", "--quiet"}).exit_code, 0);
  const std::string report = read_bytes(output("model") / "report.html");
  const Outcome outcome = compare({"--iterations", "5", "--overwrite"}, "model");
  EXPECT_EQ(outcome.exit_code, 2);
  EXPECT_NE(outcome.err.find("holds a model of b3dgs train"), std::string::npos) << outcome.err;
  EXPECT_TRUE(test::same(read_bytes(output("model") / "report.html"), report));
}

TEST_F(Compare, DoesNotReplaceAComparisonWithoutOverwrite) {
  ASSERT_EQ(compare({"--iterations", "5", "--quiet"}).exit_code, 0);
  const Outcome again = compare({"--iterations", "5"});
  EXPECT_EQ(again.exit_code, 2);
  EXPECT_NE(again.err.find("already holds a comparison"), std::string::npos) << again.err;
  const fs::path log = output() / "naive/seed_0/train.jsonl";
  std::ofstream(log, std::ios::app) << "old\n";
  EXPECT_EQ(compare({"--iterations", "6", "--overwrite", "--quiet"}).exit_code, 0);
  EXPECT_EQ(result()["summary"]["done"], 6);
  EXPECT_EQ(read_bytes(log).find("old"), std::string::npos) << "it is trained again";
  const Outcome other = run_b3dgs({"compare", "--resume", "-m", output().string(), "--configs", "naive,combined"});
  EXPECT_EQ(other.exit_code, 2);
  EXPECT_NE(other.err.find("--resume cannot change --configs"), std::string::npos) << other.err;
  // Models without a compare.json are not treated as runs of this comparison.
  fs::remove(output() / "compare.json");
  const Outcome orphans = compare({"--iterations", "7"});
  EXPECT_EQ(orphans.exit_code, 2);
  EXPECT_NE(orphans.err.find("already holds a model"), std::string::npos) << orphans.err;
  EXPECT_EQ(compare({"--iterations", "7", "--overwrite", "--quiet"}).exit_code, 0);
  EXPECT_EQ(result()["summary"]["done"], 7);
}

TEST_F(Compare, OverwriteDeletesOldRunsOnlyAfterReadingTheScene) {
  ASSERT_EQ(compare({"--iterations", "5", "--quiet", "--configs", "naive,combined"}).exit_code, 0);
  const fs::path old = output() / "combined/seed_0/point_cloud/iteration_5/point_cloud.ply";
  ASSERT_TRUE(fs::exists(old));
  const Outcome typo = run_b3dgs(
      {"compare", scene() + "x", "-m", output().string(), "--configs", "naive,combined", "--overwrite", "--quiet"});
  EXPECT_EQ(typo.exit_code, 2) << typo.err;
  EXPECT_TRUE(fs::exists(old)) << "a mistyped scene deletes nothing";
  EXPECT_EQ(result()["summary"]["done"], 5);

  ASSERT_EQ(compare({"--iterations", "5", "--overwrite", "--quiet"}).exit_code, 0);
  EXPECT_FALSE(fs::exists(old)) << "the new comparison does not have this run";
  EXPECT_TRUE(fs::exists(output() / "sub-tile/seed_0/point_cloud/iteration_5/point_cloud.ply"));
}

TEST_F(Compare, IsKeptUntilItsSuccessorIsComplete) {
  ASSERT_EQ(compare({"--iterations", "5", "--quiet", "--configs", "naive,combined"}).exit_code, 0);
  const fs::path of_naive = output() / "naive/seed_0/replaced", of_combined = output() / "combined/seed_0/replaced";
  const std::string ply = "point_cloud/iteration_5/point_cloud.ply";
  const std::string before = read_bytes(of_naive.parent_path() / ply);
  const std::string result_before = read_bytes(output() / "compare.json");
  test::RunOptions options;
  options.signal = SIGTERM;
  options.signal_when = [&] { return fs::exists(output() / "sub-tile/seed_0/train.jsonl"); };  // a new file
  const Outcome stopped = compare({"--iterations", "50000", "--overwrite", "--quiet"}, "out", options);
  ASSERT_EQ(stopped.exit_code, 143) << stopped.out << stopped.err;
  EXPECT_TRUE(test::same(read_bytes(of_naive / ply), before));
  EXPECT_TRUE(fs::exists(of_combined / ply));
  EXPECT_TRUE(test::same(read_bytes(output() / "replaced/compare.json"), result_before));

  ASSERT_EQ(compare({"--iterations", "6", "--overwrite", "--quiet"}).exit_code, 0);
  for (const fs::path& folder : {of_naive, of_combined, output() / "replaced"}) EXPECT_FALSE(fs::exists(folder));
}

TEST_F(Compare, OverwriteMovesNothingIfAFolderCannotBeMade) {
  const fs::path ply = output() / "naive/seed_0/point_cloud/iteration_5/point_cloud.ply";
  fs::create_directories(ply.parent_path());
  std::ofstream(ply) << "mine";
  fs::create_symlink("sub-tile", output() / "sub-tile");  // a link to itself with the name of a required folder
  EXPECT_EQ(compare({"--iterations", "5", "--overwrite", "--quiet"}).exit_code, 2);
  EXPECT_EQ(read_bytes(ply), "mine");
  EXPECT_FALSE(fs::exists(output() / "compare.json"));
}

TEST_F(Compare, OverwriteKeepsAFileThatIsNoComparison) {
  for (const std::string text : {"{}", "[1]", "mine"}) {
    const std::string name = "out" + std::to_string(text.size());
    fs::create_directories(output(name));
    std::ofstream(output(name) / "compare.json") << text;
    const Outcome resumed = run_b3dgs({"compare", "--resume", "-m", output(name).string()});
    EXPECT_EQ(resumed.exit_code, 2);
    EXPECT_NE(resumed.err.find("a file of b3dgs compare"), std::string::npos) << resumed.err;
    EXPECT_EQ(resumed.err.find("json.exception"), std::string::npos) << resumed.err;
    ASSERT_EQ(compare({"--iterations", "5", "--overwrite", "--quiet"}, name).exit_code, 0);
    EXPECT_EQ(read_bytes(output(name) / "compare.json.previous"), text);
    EXPECT_EQ(result(name)["summary"]["done"], 5);
  }
}

TEST_F(Compare, InitPlyReplacesMissingPointsOfTheScene) {
  ASSERT_EQ(run_b3dgs({"train", "-s", scene(), "-m", output("model").string(), "--iterations", "2", "--device", "cpu",
                       "--quiet"})
                .exit_code,
            0);
  std::ofstream(fs::path(scene()) / "sparse/0/points3D.bin", std::ios::binary) << std::string(8, '\0');  // count: 0
  const Outcome without = compare({"--iterations", "3"});
  EXPECT_EQ(without.exit_code, 0) << without.err;
  EXPECT_NE(without.out.find("found in the photographs"), std::string::npos) << without.out;
  const Outcome with = compare({"--iterations", "3", "--quiet", "--overwrite", "--init_ply",
                                (output("model") / "point_cloud/iteration_2/point_cloud.ply").string()});
  EXPECT_EQ(with.exit_code, 0) << with.err;
}

TEST_F(Compare, SeedsHave64Bits) {
  ASSERT_EQ(compare({"--iterations", "2", "--quiet", "--seed", "5000000000"}).exit_code, 0);
  EXPECT_EQ(result()["plan"]["seeds"], json::array({5000000000}));
  EXPECT_EQ(result()["runs"][0]["seed"], 5000000000);
  const json trained = json::parse(read_bytes(output() / "naive/seed_5000000000/config.json"));
  EXPECT_EQ(trained["seed"], 5000000000);
  ASSERT_EQ(compare({"--iterations", "2", "--quiet", "--overwrite", "--seeds", "1", "5000000001"}).exit_code, 0);
  EXPECT_TRUE(fs::exists(output() / "naive/seed_5000000001/train.jsonl"));
}

TEST_F(Compare, ResumeRejectsOptionsThatItWouldIgnore) {
  ASSERT_EQ(compare({"--iterations", "5", "--quiet"}).exit_code, 0);
  const auto rejected = [&](const Words& more, const std::string& reason) {
    Words words{"compare", "--resume", "-m", output().string()};
    words.insert(words.end(), more.begin(), more.end());
    const Outcome outcome = run_b3dgs(words);
    EXPECT_EQ(outcome.exit_code, 2) << outcome.out;
    EXPECT_NE(outcome.err.find(reason), std::string::npos) << outcome.err;
    EXPECT_EQ(std::count(outcome.err.begin(), outcome.err.end(), '\n'), 1) << outcome.err;
  };
  rejected({"--seed", "7"}, "the comparison has the seeds 0");
  rejected({"--overwrite"}, "--overwrite");
  rejected({"--preset", "fast"}, "--resume cannot change --preset (quality)");
  const fs::path file = output() / "seed.json";
  std::ofstream(file) << json{{"seed", 7}};
  rejected({"--config", file.string()}, "the comparison has the seeds 0");
  EXPECT_EQ(result()["plan"]["config"]["seed"], 0);
}

TEST_F(Compare, ReportRewritesThePagesFromTheFolder) {
  ASSERT_EQ(compare({"--iterations", "20", "--quiet"}).exit_code, 0);
  const std::string before = page();
  fs::remove(output() / "report.html");
  const Outcome outcome = run_b3dgs({"report", output().string()});
  EXPECT_EQ(outcome.exit_code, 0) << outcome.err;
  EXPECT_TRUE(test::same(page(), before));

  const fs::path model = output() / "naive/seed_0";
  const std::string of_model = read_bytes(model / "report.html");
  fs::remove(model / "report.html");
  EXPECT_EQ(run_b3dgs({"report", model.string()}).exit_code, 0);
  EXPECT_TRUE(test::same(read_bytes(model / "report.html"), of_model));
  fs::remove(model / "train.jsonl");
  const Outcome empty = run_b3dgs({"report", model.string()});
  EXPECT_EQ(empty.exit_code, 2);
  EXPECT_NE(empty.err.find("train.jsonl: not found"), std::string::npos) << empty.err;
  EXPECT_TRUE(test::same(read_bytes(model / "report.html"), of_model)) << "a report without curves replaces none";
  EXPECT_EQ(run_b3dgs({"report", scene()}).exit_code, 2);
  EXPECT_EQ(run_b3dgs({"report", "/nonexistent"}).exit_code, 2);
}

}  // namespace
}  // namespace b3dgs
