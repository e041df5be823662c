// Runs the program: makes a scene, trains, stops, resumes, evaluates and renders.
#include <gtest/gtest.h>

#include <algorithm>
#include <csignal>
#include <nlohmann/json.hpp>

#include "app/common/commands.h"
#include "core/text.h"
#include "model/formats/splat_formats.h"
#include "scene/images/image.h"
#include "support/files.h"
#include "support/page_data.h"
#include "support/run_program.h"
#include "support/same.h"
#include "support/temp_dir.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using test::Outcome;
using test::read_bytes;
using test::run_b3dgs;
using Words = std::vector<std::string>;

class EndToEnd : public ::testing::Test {
 protected:
  EndToEnd() {
    const Outcome made = run_b3dgs(
        {"synth", "orbit", scene(), "--points", "1500", "--views", "12", "--width", "64", "--height", "48", "--quiet"});
    EXPECT_EQ(made.exit_code, 0) << made.err;
  }

  std::string scene() const { return (folder_.path() / "scene").string(); }
  std::string model(const std::string& name = "model") const { return (folder_.path() / name).string(); }
  fs::path ply(const std::string& name, int iteration) const {
    return fs::path(model(name)) / "point_cloud" / ("iteration_" + std::to_string(iteration)) / "point_cloud.ply";
  }

  Outcome train(const Words& more, const test::RunOptions& options = {}) const {
    Words words{"train", "-s", scene(), "-m", model()};
    words.insert(words.end(), more.begin(), more.end());
    return run_b3dgs(words, options);
  }

  /// Runs a training and sends it a signal after it has written a checkpoint.
  Outcome train_and_signal(int signal, int n_signals = 1) const {
    test::RunOptions options;
    options.signal = signal;
    options.n_signals = n_signals;
    options.signal_when = [&] { return !checkpoints().empty(); };
    return train({"--iterations", "1000000", "--checkpoint_iterations", "5"}, options);
  }

  std::vector<fs::path> checkpoints(const std::string& name = "model") const {
    std::vector<fs::path> files;
    const fs::path folder = fs::path(model(name)) / "checkpoints";
    if (!fs::exists(folder)) return files;
    for (const fs::directory_entry& entry : fs::directory_iterator(folder)) {
      if (entry.path().extension() == ".b3dgs") files.push_back(entry.path());
    }
    std::sort(files.begin(), files.end());
    return files;
  }

  test::TempDir folder_;
};

TEST_F(EndToEnd, TrainsEvaluatesRendersAndDescribes) {
  const Outcome trained = train({"--eval", "--iterations", "100", "--test_iterations", "100"});
  ASSERT_EQ(trained.exit_code, 0) << trained.err;
  EXPECT_NE(trained.out.find("100 iterations"), std::string::npos) << trained.out;
  EXPECT_NE(trained.out.find("PSNR"), std::string::npos) << trained.out;
  EXPECT_NE(trained.out.find(ply("model", 100).string()), std::string::npos) << trained.out;
  const std::string floaters = " in no training view, ";
  EXPECT_NE(trained.out.find(floaters), std::string::npos) << trained.out;
  EXPECT_NE(run_b3dgs({"info", model()}).out.find(floaters), std::string::npos);
  for (const char* file : {"input.ply", "cameras.json", "cfg_args", "config.json", "train.jsonl", "report.html"}) {
    EXPECT_TRUE(fs::exists(fs::path(model()) / file)) << file;
  }

  const Outcome measured = run_b3dgs({"eval", "-m", model(), "--save_images"});
  ASSERT_EQ(measured.exit_code, 0) << measured.err;
  EXPECT_NE(measured.out.find("mean of 2"), std::string::npos) << measured.out;  // views 0 and 8 of 12
  const auto results = nlohmann::json::parse(read_bytes(fs::path(model()) / "results.json"));
  EXPECT_GT(results["ours_100"]["PSNR"].get<double>(), 18) << results;
  EXPECT_TRUE(fs::exists(fs::path(model()) / "per_view.json"));
  for (const char* kind : {"gt", "renders", "diff"}) {
    for (const char* name : {"00000.png", "00001.png"}) {
      const Image8 image = read_image(fs::path(model()) / "test" / "ours_100" / kind / name, false);
      EXPECT_EQ(image.width, 64);
      EXPECT_EQ(image.height, 48);
    }
  }
  EXPECT_EQ(read_image(fs::path(model()) / "test/ours_100/gt/00001.png", false).pixels,
            read_image(fs::path(scene()) / "images/00008.png", false).pixels);

  const auto names = nlohmann::json::parse(read_bytes(fs::path(model()) / "test/ours_100/views.json"));
  EXPECT_EQ(names["00001.png"], "00008.png") << names;
  EXPECT_EQ(names.size(), 2u);
  const Outcome again = run_b3dgs({"render", "-m", model(), "--output", model("frames"), "--no_depth", "--no_alpha"});
  ASSERT_EQ(again.exit_code, 0) << again.err;
  EXPECT_EQ(nlohmann::json::parse(read_bytes(fs::path(model("frames")) / "views.json")), names);

  const Outcome rendered = run_b3dgs({"render", "-m", model(), "--path", "interpolated", "--frames", "3"});
  ASSERT_EQ(rendered.exit_code, 0) << rendered.err;
  for (const char* kind : {"renders", "depth", "alpha"}) {
    EXPECT_TRUE(fs::exists(fs::path(model()) / "interpolated" / "ours_100" / kind / "00002.png")) << kind;
  }
  EXPECT_FALSE(fs::exists(fs::path(model()) / "interpolated/ours_100/renders/00003.png"));
  EXPECT_FALSE(fs::exists(fs::path(model()) / "interpolated/ours_100/views.json"));

  const Outcome described = run_b3dgs({"info", ply("model", 100).string()});
  ASSERT_EQ(described.exit_code, 0) << described.err;
  EXPECT_NE(described.out.find("SH degree         3"), std::string::npos) << described.out;
  const Outcome checkpoint = run_b3dgs({"info", checkpoints().at(0).string()});
  for (const char* part : {"checkpoint, checksums valid", "iteration         100 of 100", "SH degree         ",
                           "training time     ", "running average", "options that differ"}) {
    EXPECT_NE(checkpoint.out.find(part), std::string::npos) << part << " in " << checkpoint.out;
  }
  EXPECT_EQ(checkpoint.out.find("n_gaussians"), std::string::npos) << checkpoint.out;
  for (const std::string& input :
       {scene(), model(), (fs::path(model()) / "input.ply").string(), checkpoints().at(0).string()}) {
    const Outcome outcome = run_b3dgs({"info", input});
    EXPECT_EQ(outcome.exit_code, 0) << input << ": " << outcome.err;
    EXPECT_FALSE(outcome.out.empty()) << input;
  }
}

TEST_F(EndToEnd, ReadsOptionsFromAPipe) {
  test::RunOptions shell;
  shell.program = "/bin/sh";
  for (const std::string pipe : {"/dev/stdin", "/dev/fd/0"}) {
    const std::string name = model(fs::path(pipe).filename());
    const Outcome trained =
        run_b3dgs({"-c", "echo '{\"iterations\": 3, \"seed\": 7}' | " + shell_quote(B3DGS_PROGRAM) + " train -s " +
                             shell_quote(scene()) + " -m " + shell_quote(name) + " --device cpu --config " + pipe},
                  shell);
    ASSERT_EQ(trained.exit_code, 0) << trained.err;
    const auto config = nlohmann::json::parse(read_bytes(fs::path(name) / "config.json"));
    EXPECT_EQ(config["iterations"], 3);
    EXPECT_EQ(config["seed"], 7);
  }
  const Outcome ranks = run_b3dgs({"-c", "echo '{}' | " + shell_quote(B3DGS_PROGRAM) + " train -s " +
                                             shell_quote(scene()) + " --ranks 2 --device cpu --config /dev/stdin"},
                                  shell);
  EXPECT_EQ(ranks.exit_code, 2);
  EXPECT_EQ(ranks.err.rfind("error: --config /dev/stdin can be read only once, but each rank reads it", 0), 0u)
      << ranks.err;
}

TEST_F(EndToEnd, DescribesASceneInATransformsFile) {
  const fs::path described = folder_.path() / "described";
  fs::create_directories(described / "images");
  fs::copy_file(fs::path(scene()) / "images/00000.png", described / "images/a.png");
  test::write_bytes(described / "transforms.json",
                    R"({"camera_angle_x": 0.9, "frames": [{"file_path": "images/a.png",
                        "transform_matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 3], [0, 0, 0, 1]]}]})");
  const Outcome outcome = run_b3dgs({"info", described.string()});
  EXPECT_EQ(outcome.exit_code, 0) << outcome.err;
  EXPECT_NE(outcome.out.find("transforms.json"), std::string::npos) << outcome.out;
}

TEST_F(EndToEnd, EvaluatesWithExposures) {
  const Outcome refused = train({"--exposure", "--train_test_exp", "--iterations", "5"});
  EXPECT_NE(refused.exit_code, 0);
  EXPECT_NE(refused.err.find("--train_test_exp: needs test views"), std::string::npos) << refused.err;
  const Outcome trained = train({"--eval", "--exposure", "--train_test_exp", "--iterations", "30"});
  ASSERT_EQ(trained.exit_code, 0) << trained.err;
  EXPECT_NE(trained.out.find("on the right half of 2 test views"), std::string::npos) << trained.out;
  EXPECT_EQ(test::data_of_page(read_bytes(fs::path(model()) / "report.html"))["measures_half"], true);

  const Outcome of_test = run_b3dgs({"eval", "-m", model()});
  ASSERT_EQ(of_test.exit_code, 0) << of_test.err;
  EXPECT_NE(of_test.out.find("test views, right half, with colours fitted"), std::string::npos) << of_test.out;
  EXPECT_NE(of_test.out.find("CC PSNR"), std::string::npos) << of_test.out;
  const auto results = nlohmann::json::parse(read_bytes(fs::path(model()) / "results.json"))["ours_30"];
  EXPECT_TRUE(results.at("train_test_exp").get<bool>());
  EXPECT_GT(results.at("CC_PSNR").get<double>(), results.at("PSNR").get<double>() - 0.05);

  const Outcome of_train = run_b3dgs({"eval", "-m", model(), "--split", "train"});
  ASSERT_EQ(of_train.exit_code, 0) << of_train.err;
  EXPECT_NE(of_train.out.find("train views, with their learned exposures"), std::string::npos) << of_train.out;
  const fs::path exposures = ply("model", 30).parent_path() / "exposure.json";
  ASSERT_TRUE(fs::exists(exposures));
  EXPECT_EQ(read_bytes(exposures), read_bytes(fs::path(model()) / "exposure.json"));
  fs::remove(exposures);
  const Outcome without = run_b3dgs({"eval", "-m", model(), "--split", "train"});
  EXPECT_EQ(without.exit_code, 0) << without.err;
  EXPECT_NE(without.err.find("exposure.json is missing"), std::string::npos) << without.err;
}

TEST_F(EndToEnd, TheReportShowsTheModelThatIsSaved) {
  // The opacity reset after the last iteration affects only the checkpoint, for a resumed training.
  const Outcome trained =
      train({"--preset", "inria", "--eval", "--iterations", "60", "--opacity_reset_interval", "60"});
  ASSERT_EQ(trained.exit_code, 0) << trained.err;
  const auto views = nlohmann::json::parse(read_bytes(fs::path(model()) / "per_view.json"))["ours_60"]["PSNR"];
  const auto record = nlohmann::json::parse(read_bytes(fs::path(model()) / "report" / "run.json"));
  ASSERT_EQ(record["previews"].size(), 2u);
  for (const auto& preview : record["previews"]) {
    EXPECT_EQ(preview["psnr"], views[preview["view"].get<std::string>()]) << record;
  }
}

TEST_F(EndToEnd, APlyIsRenderedWithTheCamerasOfAScene) {
  const std::string truth = scene() + "/truth.ply";
  const std::string output = model("frames");
  const Outcome outcome =
      run_b3dgs({"render", "--ply", truth, "-s", scene(), "--output", output, "--no-depth", "--no-alpha"});
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  // The scene's images are renders of this PLY.
  EXPECT_EQ(read_image(output + "/renders/00003.png", false).pixels,
            read_image(scene() + "/images/00003.png", false).pixels);
  EXPECT_FALSE(fs::exists(output + "/depth"));
}

TEST_F(EndToEnd, ASignalLeavesACheckpointToResume) {
  for (const auto& [signal, code] : {std::pair{SIGHUP, 129}, std::pair{SIGINT, 130}, std::pair{SIGTERM, 143}}) {
    remove_tree(model());
    const Outcome stopped = train_and_signal(signal);
    ASSERT_EQ(stopped.exit_code, code) << stopped.err;
    EXPECT_NE(stopped.out.find("--resume"), std::string::npos) << stopped.out;
    ASSERT_FALSE(checkpoints().empty());
    const Outcome info = run_b3dgs({"info", checkpoints().back().string()});
    EXPECT_EQ(info.exit_code, 0) << info.err;

    int newest = 0;
    for (const fs::path& file : checkpoints()) newest = std::max(newest, std::stoi(file.stem().string().substr(10)));
    const std::string last = std::to_string(newest + 3);
    const Outcome resumed = run_b3dgs({"train", "-m", model(), "--resume", "auto", "--iterations", last});
    ASSERT_EQ(resumed.exit_code, 0) << resumed.err;
    EXPECT_NE(resumed.out.find("iterations: 1000000 -> " + last), std::string::npos) << resumed.out;
    EXPECT_TRUE(fs::exists(ply("model", newest + 3)));
  }
}

TEST_F(EndToEnd, SignalsInQuickSuccessionAreOneRequest) {
  // timeout(1) signals the program and its process group. If the second signal killed the program, the exit code would
  // be the same, but not the output.
  const Outcome stopped = train_and_signal(SIGTERM, 4);
  EXPECT_EQ(stopped.exit_code, 143) << stopped.err;
  EXPECT_NE(stopped.out.find("--resume"), std::string::npos) << stopped.out;
}

TEST_F(EndToEnd, TenIterationsAndTenMoreEqualTwenty) {
  // Density control at 4, 8, 12, 16 and the opacity reset at 12 are on both sides of the interruption. On a CPU both
  // candidates compute the same bits, so it does not matter which is faster.
  const Words schedule{"--preset",
                       "inria",
                       "--densify_from_iter",
                       "2",
                       "--densification_interval",
                       "4",
                       "--opacity_reset_interval",
                       "12",
                       "--densify_grad_threshold",
                       "0.00001",
                       "--sh_increase_interval",
                       "7",
                       "--kernel_check_interval",
                       "8"};
  const auto train_into = [&](const std::string& name, Words words) {
    words.insert(words.begin(), {"train", "-s", scene(), "-m", model(name)});
    words.insert(words.end(), schedule.begin(), schedule.end());
    const Outcome outcome = run_b3dgs(words);
    EXPECT_EQ(outcome.exit_code, 0) << outcome.err;
  };
  train_into("whole", {"--iterations", "20"});
  train_into("halves", {"--iterations", "10"});
  train_into("halves", {"--iterations", "20", "--resume", "auto"});
  const std::string whole = read_bytes(ply("whole", 20));
  ASSERT_FALSE(whole.empty());
  EXPECT_TRUE(test::same(whole, read_bytes(ply("halves", 20))));
  EXPECT_FALSE(whole == read_bytes(ply("halves", 10)));
}

TEST_F(EndToEnd, AModelIsNotReplacedByAccident) {
  ASSERT_EQ(train({"--iterations", "5"}).exit_code, 0);
  const std::string before = read_bytes(ply("model", 5));
  const Outcome again = train({"--iterations", "3"});
  EXPECT_EQ(again.exit_code, 2);
  EXPECT_NE(again.err.find("already holds a model"), std::string::npos) << again.err;
  EXPECT_TRUE(test::same(read_bytes(ply("model", 5)), before));

  const Outcome replaced = train({"--iterations", "3", "--overwrite"});
  EXPECT_EQ(replaced.exit_code, 0) << replaced.err;
  EXPECT_TRUE(fs::exists(ply("model", 3)));
  EXPECT_FALSE(fs::exists(ply("model", 5))) << "left over from the replaced model";
}

TEST_F(EndToEnd, ResumeAutoWithoutACheckpointStartsFromTheBeginning) {
  const Outcome outcome = train({"--iterations", "3", "--resume", "auto"});
  EXPECT_EQ(outcome.exit_code, 0);
  EXPECT_NE(outcome.err.find("no checkpoint to resume in "), std::string::npos) << outcome.err;
  EXPECT_TRUE(fs::exists(ply("model", 3)));
}

TEST_F(EndToEnd, AFullDiskLosesNothing) {
  ASSERT_EQ(train({"--iterations", "5"}).exit_code, 0);
  const std::vector<fs::path> kept = checkpoints();
  test::RunOptions full;
  full.file_size_limit = 4096;
  const Outcome outcome = run_b3dgs({"train", "-m", model(), "--resume", "auto", "--iterations", "10"}, full);
  EXPECT_EQ(outcome.exit_code, 2);
  EXPECT_NE(outcome.err.find("error: "), std::string::npos) << outcome.err;
  EXPECT_EQ(checkpoints(), kept);
  for (const fs::directory_entry& entry : fs::recursive_directory_iterator(model())) {
    EXPECT_NE(entry.path().extension(), ".tmp") << entry.path();
  }
  const Outcome resumed = run_b3dgs({"train", "-m", model(), "--resume", "auto", "--iterations", "10"});
  EXPECT_EQ(resumed.exit_code, 0) << resumed.err;
}

TEST_F(EndToEnd, QuietPrintsResultsOnly) {
  const Outcome outcome = train({"--iterations", "3", "--quiet"});
  EXPECT_EQ(outcome.exit_code, 0);
  EXPECT_EQ(outcome.err, "");
  EXPECT_EQ(outcome.out.compare(0, 7, "trained"), 0) << outcome.out;
}

TEST_F(EndToEnd, TheDefaultModelFolderIsNamedAfterTheScene) {
  test::RunOptions here;
  here.folder = folder_.path();
  const Outcome outcome = run_b3dgs({"train", "-s", "scene/", "--iterations", "2"}, here);
  EXPECT_EQ(outcome.exit_code, 0) << outcome.err;
  EXPECT_TRUE(fs::exists(folder_.path() / "output" / "scene" / "point_cloud"));
  // The training was given the scene relative to its working folder. The model stores the absolute path.
  EXPECT_EQ(run_b3dgs({"eval", "-m", (folder_.path() / "output" / "scene").string()}).exit_code, 0);
}

TEST(Program, PrintsVersionAndHelp) {
  const Outcome version = run_b3dgs({"--version"});
  EXPECT_EQ(version.exit_code, 0);
  EXPECT_EQ(version.out.compare(0, 6, "b3dgs "), 0);
  const Outcome help = run_b3dgs({"--help"});
  EXPECT_EQ(help.exit_code, 0);
  for (const CommandName& command : kCommandNames) {
    const std::string name = command.name;
    EXPECT_NE(help.out.find("\n  " + name + " "), std::string::npos) << name;
    const Outcome of_command = run_b3dgs({name, "--help"});
    EXPECT_EQ(of_command.exit_code, 0) << name;
    EXPECT_NE(of_command.out.find("Usage: b3dgs " + name), std::string::npos) << name;
  }
  EXPECT_EQ(run_b3dgs({"help", "report"}).out, run_b3dgs({"report", "--help"}).out);
  EXPECT_EQ(run_b3dgs({"help", "bench", "step"}).out, run_b3dgs({"bench", "step", "--help"}).out);
  EXPECT_EQ(run_b3dgs({}).exit_code, 2);
}

}  // namespace
}  // namespace b3dgs
