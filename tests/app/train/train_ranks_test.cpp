// b3dgs train on several ranks: options, launchers, and which of the ranks prints.
#include "app/train/rank_setup.h"

#include <gtest/gtest.h>
#include <omp.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <string>
#include <utility>
#include <vector>

#include "core/check.h"
#include "core/parallel.h"
#include "dist/control/socket.h"
#include "model/model_folder.h"
#include "support/expect_error.h"
#include "support/files.h"
#include "support/run_program.h"
#include "support/same.h"
#include "support/temp_dir.h"
#include "support/variables.h"
#include "train/device.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using test::Outcome;
using test::read_bytes;
using test::run_b3dgs;
using test::Variables;
using Words = std::vector<std::string>;

std::vector<std::pair<const char*, std::string>> launched(int rank, int size, int port = 29500) {
  return {{"RANK", std::to_string(rank)},
          {"WORLD_SIZE", std::to_string(size)},
          {"LOCAL_RANK", std::to_string(rank)},
          {"MASTER_ADDR", "127.0.0.1"},
          {"MASTER_PORT", std::to_string(port)}};
}

std::vector<std::pair<const char*, std::string>> without_gpus() {
  return {{"CUDA_VISIBLE_DEVICES", ""}};
}

int count_of(const std::string& text, const std::string& part) {
  int n = 0;
  for (std::size_t at = text.find(part); at != std::string::npos; at = text.find(part, at + 1)) ++n;
  return n;
}

class TrainRanks : public testing::Test {
 protected:
  TrainRanks() {
    const Outcome made = run_b3dgs(
        {"synth", "orbit", scene(), "--points", "300", "--views", "6", "--width", "48", "--height", "36", "--quiet"});
    EXPECT_EQ(made.exit_code, 0) << made.err;
  }

  /// Trains two ranks like a launcher, each with more words, and returns their output, with their exit codes.
  std::vector<std::string> launch(const std::string& words_of_first, const std::string& words_of_second) const {
    int port = 0;
    {
      const Socket free = listen_at("127.0.0.1", 0);
      port = port_of(free);
    }
    std::string command;
    for (const int rank : {1, 0}) {
      const std::string out = (temp / ("rank" + std::to_string(rank))).string();
      command += "(";
      for (const auto& [name, value] : launched(rank, 2, port)) command += std::string(name) + "=" + value + " ";
      command += std::string(B3DGS_PROGRAM) + " train " + scene() + " -m " + model() + " --device cpu " +
                 (rank == 0 ? words_of_first : words_of_second) + " > " + out + " 2>&1; echo code $? >> " + out +
                 ") & ";
    }
    EXPECT_EQ(std::system((command + " wait").c_str()), 0);
    return {read_bytes(temp / "rank0"), read_bytes(temp / "rank1")};
  }

  std::string scene() const { return (temp / "scene").string(); }
  std::string model(const std::string& name = "model") const { return (temp / name).string(); }

  Outcome train(const Words& more, const std::string& name = "model") const {
    Words words{"train", "-s", scene(), "-m", model(name), "--iterations", "4"};
    words.insert(words.end(), more.begin(), more.end());
    return run_b3dgs(words);
  }

  /// Expects one line of error, and that nothing was started or written.
  void expect_refused(const Words& words, const std::string& error) const {
    const Outcome outcome = train(words);
    EXPECT_EQ(outcome.exit_code, 2) << outcome.err;
    EXPECT_EQ(outcome.err.rfind("error: " + error, 0), 0u) << outcome.err;
    EXPECT_EQ(count_of(outcome.err, "\n"), 1) << outcome.err;
    EXPECT_EQ(outcome.out, "");
    EXPECT_FALSE(fs::exists(model()));
  }

  const test::TempDir temp;
};

using TrainRanksOnCpu = TrainRanks;

TEST_F(TrainRanks, RefusesOptionsThatContradictEachOther) {
  expect_refused({"--ranks", "2", "--gpus", "2"}, "--ranks and --gpus exclude each other");
  expect_refused({"--gpus", "2", "--device", "cpu"}, "--gpus 2 and --device cpu exclude each other");
  for (const char* const wrong : {"0", "-1", "two", "2x", "1025"}) {
    expect_refused({std::string("--gpus=") + wrong}, "invalid value for --gpus (expected auto, or a whole number");
  }
  const Variables variables(launched(0, 3));
  expect_refused({"--ranks", "2"}, "2 ranks requested, but a launcher");
  expect_refused({"--gpus", "2"}, "2 ranks requested, but a launcher");
}

TEST_F(TrainRanks, RefusesMoreRanksThanGpus) {
  const Variables variables(without_gpus());
  expect_refused({"--gpus", "2"}, "--gpus 2: ");
  expect_refused({"--ranks", "3", "--device", "cuda"}, "--ranks 3: ");
  expect_refused({"--gpus", "1"}, "--gpus 1: ");
}

TEST_F(TrainRanks, TrainsAloneWhereThatIsAskedFor) {
  const Variables variables(without_gpus());
  ASSERT_EQ(train({}).exit_code, 0);
  const std::string ply = read_bytes(ModelFolder(model()).ply(4));
  ASSERT_EQ(train({"--gpus", "auto"}, "auto").exit_code, 0) << "auto without GPUs";
  EXPECT_TRUE(test::same(read_bytes(ModelFolder(model("auto")).ply(4)), ply));
  const Variables launcher(launched(1, 3));
  const Outcome alone = train({"--ranks", "1"}, "alone");
  ASSERT_EQ(alone.exit_code, 0) << "whatever started this process: " << alone.err;
  EXPECT_TRUE(test::same(read_bytes(ModelFolder(model("alone")).ply(4)), ply));
}

TEST_F(TrainRanksOnCpu, OneRankSpeaksAndEachDrawsAView) {
  const Outcome outcome = train({"--ranks", "2", "--device", "cpu"});
  const int threads = std::max(1, omp_get_num_procs() / 2);
  EXPECT_EQ(count_of(outcome.out, "device      "), 1) << outcome.out;
  EXPECT_EQ(count_of(outcome.out, "device      CPU, " + std::to_string(threads) + " thread"), 1) << outcome.out;
  EXPECT_EQ(count_of(outcome.out, "ranks       2, 2 views per step (one per rank; --batch changes it)\n"), 1)
      << outcome.out;
  EXPECT_EQ(count_of(outcome.err, "reading image headers 6/6\n"), 1) << outcome.err;
}

TEST_F(TrainRanksOnCpu, AGivenBatchStands) {
  const Outcome outcome = train({"--ranks", "2", "--device", "cpu", "--batch", "3", "--threads", "1"});
  EXPECT_EQ(count_of(outcome.out, "ranks       2, 3 views per step\n"), 1) << outcome.out;
  EXPECT_EQ(count_of(outcome.out, "device      CPU, 1 thread\n"), 1) << outcome.out;
}

TEST_F(TrainRanksOnCpu, RefusesFewerViewsInAStepThanRanks) {
  expect_refused({"--ranks", "3", "--device", "cpu", "--batch", "2"},
                 "--batch 2 is too small for 3 ranks, each of which renders at least one view of a step; use --batch 3 "
                 "or more, or at most 2 ranks\n");
  expect_refused({"--ranks", "33", "--device", "cpu"},
                 "--batch 32 is too small for 33 ranks, each of which renders at least one view of a step; use at most "
                 "32 ranks\n");
  ASSERT_EQ(train({"--device", "cpu", "--checkpoint_iterations", "4"}).exit_code, 0);
  const Outcome outcome =
      run_b3dgs({"train", "-m", model(), "--resume", "auto", "--iterations", "8", "--ranks", "2", "--device", "cpu"});
  EXPECT_EQ(outcome.exit_code, 2);
  EXPECT_EQ(
      outcome.err,
      "error: --batch 1 is too small for 2 ranks, each of which renders at least one view of a step; use --batch 2 "
      "or more, or at most 1 rank\n");
}

TEST_F(TrainRanksOnCpu, AResumedTrainingKeepsItsBatch) {
  ASSERT_EQ(train({"--device", "cpu", "--batch", "4", "--checkpoint_iterations", "4"}).exit_code, 0);
  const Outcome outcome =
      run_b3dgs({"train", "-m", model(), "--resume", "auto", "--iterations", "8", "--ranks", "2", "--device", "cpu"});
  EXPECT_EQ(count_of(outcome.out, "ranks       2, 4 views per step\n"), 1) << outcome.out << outcome.err;
}

TEST_F(TrainRanksOnCpu, TheErrorOfARankEndsAll) {
  ASSERT_EQ(train({"--device", "cpu"}).exit_code, 0);
  const std::string error = "output folder already holds a model: " + model();  // only rank 0 looks at it
  const Outcome started = train({"--ranks", "2", "--device", "cpu"});
  EXPECT_EQ(started.exit_code, 2);
  EXPECT_EQ(count_of(started.err, "\n"), 2) << started.err;
  EXPECT_EQ(count_of(started.err, "error: " + error), 1) << started.err;
  EXPECT_EQ(count_of(started.err, "error: rank 0 of 2 stopped: " + error), 1) << started.err;
}

TEST_F(TrainRanksOnCpu, ExitCodesTellWhichRankFailed) {
  ASSERT_EQ(train({"--device", "cpu"}).exit_code, 0);
  const std::vector<std::string> printed = launch("", "");
  const std::string &first = printed[0], &second = printed[1];
  EXPECT_EQ(first.rfind("error: output folder already holds a model", 0), 0u) << first;
  EXPECT_EQ(count_of(first, "code 2\n"), 1) << first;
  EXPECT_EQ(second.rfind("error: rank 0 of 2 stopped: output folder already holds a model", 0), 0u) << second;
  EXPECT_EQ(count_of(second, "code 3\n"), 1) << second;
}

TEST_F(TrainRanksOnCpu, OptionsMustBeThoseOfRank0) {
  const std::vector<std::string> printed = launch("--iterations 4 --seed 1", "--seed 2 --iterations 4");
  const std::string error =
      "--seed: rank 1 was started with other options than rank 0 (expected 1, found 2); start all ranks";
  EXPECT_EQ(printed[1].rfind("error: " + error, 0), 0u) << printed[1];
  EXPECT_EQ(count_of(printed[1], "code 2\n"), 1) << printed[1];
  EXPECT_EQ(printed[0].rfind("error: rank 1 of 2 stopped: " + error, 0), 0u) << printed[0];
  EXPECT_FALSE(fs::exists(model()));
  const std::string path(100, 'x');  // errors show the first 80 characters
  EXPECT_EQ(launch("--masks " + path + "1", "--masks " + path + "2")[1].rfind("error: --masks: rank 1", 0), 0u);
}

TEST(RankSetup, ALoneRankHasTheWholeMachine) {
  const MachineShare share = share_machine(*Communicator::alone());
  EXPECT_EQ(share.n_ranks, 1);
  EXPECT_EQ(share.n_cores, omp_get_num_procs());
}

TEST(RankSetup, ARankUsesTheGpuOfItsNumber) {
  RankPlace place;
  place.rank = 3;
  place.size = 4;
  place.local_rank = 1;
  for (const char* const name : {"auto", "cuda"}) {
    EXPECT_EQ(choose_rank_device(name, place, 2), torch::Device(torch::kCUDA, 1));
    EXPECT_TRUE(test::fails_with<InputError>({"rank 3 of 4 needs a GPU of its own", "sees 1 GPU;", "--gpus-per-task"},
                                             [&] { choose_rank_device(name, place, 1); }))
        << "never the CPU beside GPUs of other ranks";
  }
  EXPECT_TRUE(test::fails_with<InputError>({"share GPUs, which is slow (--ranks 4 --device cuda)"},
                                           [&] { choose_rank_device("cuda", place, 1); }));
  EXPECT_EQ(choose_rank_device("auto", place, 0), torch::Device(torch::kCPU));
  EXPECT_EQ(choose_rank_device("cpu", place, 2), torch::Device(torch::kCPU));
  EXPECT_TRUE(test::fails_with<InputError>({"sees 0 GPUs;"}, [&] { choose_rank_device("cuda", place, 0); }));
}

TEST(RankSetup, RanksShareGpusOnlyIfThatIsSaid) {
  RankPlace place;
  place.rank = place.local_rank = 3;
  place.size = 4;
  const bool may_share = true;
  EXPECT_EQ(choose_rank_device("cuda", place, 1, may_share), torch::Device(torch::kCUDA, 0));
  EXPECT_EQ(choose_rank_device("cuda", place, 2, may_share), torch::Device(torch::kCUDA, 1));
  EXPECT_EQ(choose_rank_device("cuda", place, 4, may_share), torch::Device(torch::kCUDA, 3));
  EXPECT_TRUE(test::fails_with<InputError>({"sees 0 GPUs;"}, [&] { choose_rank_device("cuda", place, 0, may_share); }));
  const Variables variables(launched(3, 4));
  EXPECT_TRUE(plan_ranks({4, ""}, "cuda").may_share_gpus);
  EXPECT_FALSE(plan_ranks({4, ""}, "auto").may_share_gpus);
  EXPECT_FALSE(plan_ranks({0, ""}, "cuda").may_share_gpus) << "a launcher may have started too many by mistake";
  EXPECT_FALSE(plan_ranks({0, "4"}, "cuda").may_share_gpus);
}

TEST(RankSetup, DefaultThreadsAreThoseOfAShare) {
  set_default_threads(3);
  set_compute_threads(0);
  EXPECT_EQ(thread_count(), 3);
  set_compute_threads(2);
  EXPECT_EQ(thread_count(), 2) << "given";
  set_default_threads(0);
  set_compute_threads(0);
  EXPECT_EQ(thread_count(), omp_get_num_procs());
}

TEST(RankSetup, RepeatsTheOptions) {
  EXPECT_EQ(RankOptions{}.as_words(), "");
  EXPECT_EQ((RankOptions{2, ""}.as_words()), " --ranks 2");
  EXPECT_EQ((RankOptions{0, "auto"}.as_words()), " --gpus auto");
}

}  // namespace
}  // namespace b3dgs
