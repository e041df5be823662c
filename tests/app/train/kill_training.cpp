// Kills trainings at random moments, resumes them, and compares the result with an uninterrupted training. The last PLY
// must be identical byte by byte, and the model folder must be usable after every kill.
//
//   kill_training FOLDER [--kills N] [--seed S] [--device cpu|cuda] [--keep]
//
// FOLDER is created, and removed at the end unless --keep is given. Each training is a fork of this process, which has
// loaded LibTorch once and starts no threads, so that a thousand kills take only minutes.
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <iostream>
#include <nlohmann/json.hpp>
#include <random>
#include <set>
#include <string>
#include <thread>
#include <vector>

#include "app/common/commands.h"
#include "core/check.h"
#include "core/files/folders.h"
#include "model/formats/splat_formats.h"
#include "model/model_folder.h"
#include "support/files.h"
#include "train/checkpoint/checkpoint.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using Words = std::vector<std::string>;
using Clock = std::chrono::steady_clock;

struct Options {
  fs::path folder;
  int kills = 10;
  unsigned seed = 1;
  std::string device = "cpu";
  bool keep = false;
};

Options parse(const Words& words) {
  Options options;
  for (std::size_t i = 0; i < words.size(); ++i) {
    const auto value = [&] {
      return ++i < words.size() ? words[i] : throw InputError("missing value for " + words[i - 1]);
    };
    if (words[i] == "--kills") {
      options.kills = std::stoi(value());
    } else if (words[i] == "--seed") {
      options.seed = static_cast<unsigned>(std::stoul(value()));
    } else if (words[i] == "--device") {
      options.device = value();
    } else if (words[i] == "--keep") {
      options.keep = true;
    } else {
      options.folder = words[i];
    }
  }
  if (options.folder.empty())
    input_error("usage: kill_training FOLDER [--kills N] [--seed S] [--device cpu|cuda] [--keep]");
  return options;
}

[[noreturn]] void fail(const std::string& what) {
  throw Error(what);
}

/// Starts a process that runs `work` with its output in `log`. It exits with the result of `work`, or 1 after an
/// exception.
template <class Work>
pid_t start(const fs::path& log, Work&& work) {
  std::cout.flush();
  const pid_t child = ::fork();
  if (child != 0) return child;
  if (std::freopen(log.c_str(), "w", stdout) == nullptr || ::dup2(STDOUT_FILENO, STDERR_FILENO) < 0) ::_exit(3);
  int code = 1;
  try {
    code = work();
  } catch (const std::exception& error) {
    std::cerr << error.what() << std::endl;
  }
  std::cout.flush();
  std::fflush(nullptr);
  ::_exit(code);
}

int wait_for_end(pid_t child) {
  int status = 0;
  while (::waitpid(child, &status, 0) < 0 && errno == EINTR) {
  }
  return status;
}

void expect_success(int status, const fs::path& log) {
  if (WIFEXITED(status) && WEXITSTATUS(status) == 0) return;
  fail("training failed with status " + std::to_string(status) + ": " + test::read_bytes(log));
}

/// Options with density control, opacity resets, evaluations, intermediate PLYs, and checkpoints every three
/// iterations.
Words training(const Options& options, const fs::path& model, bool resumes) {
  Words words{"-s",
              (options.folder / "scene").string(),
              "-m",
              model.string(),
              "--device",
              options.device,
              "--eval",
              "--iterations",
              "40",
              "--checkpoint_iterations",
              "3,6,9,12,15,18,21,24,27,30,33,36,39",
              "--preset",
              "inria",
              "--save_iterations",
              "10",
              "25",
              "--test_iterations",
              "20",
              "--sh_degree",
              "1",
              "--sh_increase_interval",
              "7",
              "--densify_from_iter",
              "2",
              "--densification_interval",
              "4",
              "--densify_grad_threshold",
              "0.00001",
              "--opacity_reset_interval",
              "18",
              "--deterministic",
              "--threads",
              "1",
              "--quiet"};
  if (resumes) words.insert(words.end(), {"--resume", "auto"});
  return words;
}

/// Checks invariants that hold at any moment.
void check_folder(const ModelFolder& folder) {
  for (const int iteration : folder.checkpoint_iterations()) verify_checkpoint_file(folder.checkpoint(iteration));
  for (const int iteration : folder.ply_iterations()) read_splat_ply(folder.ply(iteration));
  for (const char* name : {"config.json", "cameras.json", "training.json", "results.json", "per_view.json"}) {
    const fs::path path = folder.root() / name;
    if (fs::exists(path) && nlohmann::json::parse(test::read_bytes(path), nullptr, false).is_discarded()) {
      fail("not valid JSON: " + path.string());
    }
  }
}

/// Checks invariants that hold at the end.
void check_end(const ModelFolder& folder, const std::string& expected) {
  if (test::read_bytes(folder.ply(40)) != expected)
    fail("differs from the PLY of the uninterrupted training: " + folder.ply(40).string());
  for (const fs::directory_entry& entry : fs::recursive_directory_iterator(folder.root())) {
    const std::string name = entry.path().filename().string();
    if (name == ".b3dgs-files") continue;  // the list of files that the training has written (own_files.h)
    if (name.compare(0, 6, ".b3dgs") == 0) fail("temporary file was not removed: " + entry.path().string());
  }
  int last = 0;
  std::istringstream log(test::read_bytes(folder.log()));
  for (std::string line; std::getline(log, line);) {
    const nlohmann::json json = nlohmann::json::parse(line);
    if (json.contains("event")) continue;
    if (json["iteration"].get<int>() <= last)
      fail(folder.log().string() + ": " + line + " follows " + std::to_string(last));
    last = json["iteration"];
  }
  if (last != 40) fail(folder.log().string() + ": ends at " + std::to_string(last));
}

int run(const Options& options) {
  fs::create_directories(options.folder);
  const fs::path log = options.folder / "log.txt";
  const Words scene{"orbit",       (options.folder / "scene").string(),
                    "--points",    "300",
                    "--views",     "9",
                    "--width",     "48",
                    "--height",    "36",
                    "--overwrite", "--quiet"};
  expect_success(wait_for_end(start(log, [&] { return run_synth(scene); })), log);

  const ModelFolder whole(options.folder / "whole");
  const auto begin = Clock::now();
  expect_success(wait_for_end(start(log, [&] { return run_train(training(options, whole.root(), false)); })), log);
  double whole_s = std::chrono::duration<double>(Clock::now() - begin).count();
  const std::string expected = test::read_bytes(whole.ply(40));
  check_end(whole, expected);

  std::mt19937 random(options.seed);
  int n_kills = 0, n_trainings = 0, n_attempts = 0;
  std::set<int> killed_after;  // iteration of the newest checkpoint at each kill
  while (n_kills < options.kills) {
    const ModelFolder folder(options.folder / ("model_" + std::to_string(n_trainings)));
    for (bool is_done = false, is_first = true; !is_done; ++n_attempts, is_first = false) {
      const auto attempt_begin = Clock::now();
      // The delay may exceed the duration of the training, which is then not killed.
      const double delay_s = std::uniform_real_distribution<double>(0, 1.1 * whole_s)(random);
      const pid_t child = start(log, [&] { return run_train(training(options, folder.root(), true)); });
      const auto moment = Clock::now() + std::chrono::duration<double>(n_kills < options.kills ? delay_s : 1e9);
      int status = 0;
      pid_t ended = 0;
      while ((ended = ::waitpid(child, &status, WNOHANG)) == 0 && Clock::now() < moment) {
        std::this_thread::sleep_for(std::chrono::microseconds(200));
      }
      if (ended == 0) {
        ::kill(child, SIGKILL);
        status = wait_for_end(child);
      }
      check_folder(folder);
      if (WIFSIGNALED(status) && WTERMSIG(status) == SIGKILL) {
        if (++n_kills % 50 == 0) std::cout << n_kills << " kills" << std::endl;
        const std::vector<int> iterations = folder.checkpoint_iterations();
        killed_after.insert(iterations.empty() ? 0 : iterations.back());
      } else {
        expect_success(status, log);
        is_done = true;
        // The speed of the machine may have changed, but the kills must occur during the training.
        if (is_first) whole_s = std::chrono::duration<double>(Clock::now() - attempt_begin).count();
      }
    }
    check_end(folder, expected);
    ++n_trainings;
    if (!options.keep) remove_tree(folder.root());
  }
  std::printf("%d kills in %d trainings, after %zu different checkpoints: all folders usable, all PLYs identical\n",
              n_kills, n_trainings, killed_after.size());
  if (!options.keep) remove_tree(options.folder);
  return 0;
}

}  // namespace
}  // namespace b3dgs

int main(int argc, char** argv) {
  try {
    return b3dgs::run(b3dgs::parse({argv + 1, argv + argc}));
  } catch (const std::exception& error) {
    std::cerr << "kill_training: " << error.what() << std::endl;
    return 1;
  }
}
