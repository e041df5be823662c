// Tests real processes that exchange tensors and messages, fail, and are killed: dist_rank.cpp, on CPUs. Time limits
// are far above the needs of a loaded machine, or far below the time at which the test would otherwise end.
#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <csignal>
#include <cstdlib>
#include <filesystem>
#include <optional>
#include <sstream>
#include <thread>

#include "dist/control/message.h"
#include "dist/control/socket.h"
#include "support/run_program.h"
#include "support/temp_dir.h"
#include "support/variables.h"

namespace b3dgs {
namespace {

using test::Outcome;
using test::run_b3dgs;  // runs dist_rank here
using test::Variables;

int count_of(const std::string& text, const std::string& part) {
  int n = 0;
  for (std::size_t at = text.find(part); at != std::string::npos; at = text.find(part, at + 1)) ++n;
  return n;
}

/// Expects that all ranks but the failing one print `line`, once each, and that nothing else is printed except `own`.
void expect_named(const Outcome& outcome, int exit_code, int n_others, const std::string& line,
                  const std::string& own) {
  EXPECT_EQ(outcome.exit_code, exit_code) << outcome.err;
  EXPECT_EQ(count_of(outcome.err, line), n_others) << outcome.err;
  EXPECT_EQ(count_of(outcome.err, own), own.empty() ? static_cast<int>(outcome.err.size()) + 1 : 1) << outcome.err;
}

class Collectives : public testing::TestWithParam<int> {};

TEST_P(Collectives, TransferEveryByte) {
  const Outcome outcome = run_b3dgs({std::to_string(GetParam()), "collectives"});
  EXPECT_EQ(outcome.exit_code, 0) << outcome.err;
  EXPECT_EQ(count_of(outcome.out, "ok "), GetParam()) << outcome.out;
}

// Alone, a pair, and a number that is not a power of two.
INSTANTIATE_TEST_SUITE_P(Ranks, Collectives, testing::Values(1, 2, 3));

TEST(Ranks, TransferEveryByteThroughRankZero) {
  const Variables relay{{"TEST_RELAY", "1"}};
  const Outcome outcome = run_b3dgs({"3", "collectives"});
  EXPECT_EQ(outcome.exit_code, 0) << outcome.err;
  EXPECT_EQ(count_of(outcome.out, "ok "), 3) << outcome.out;
}

TEST(Ranks, FindEachOtherBesideTorchrunsAgent) {
  const Outcome outcome = run_b3dgs({"2", "agent"});
  EXPECT_EQ(outcome.exit_code, 0) << outcome.err;
  EXPECT_EQ(count_of(outcome.out, "ok "), 2) << outcome.out;
}

constexpr char kVanished[] = "stopped: its process ended without saying why";

TEST(FailingRank, KilledWhileOthersExchangeTensors) {
  expect_named(run_b3dgs({"3", "kill:tensors"}), 128 + SIGKILL, 2, std::string("error: rank 2 of 3 ") + kVanished,
               "error: rank 2 of 3 was killed by signal 9 (Killed)\n");
}

TEST(FailingRank, RankZeroKilledWhileOthersExchangeRecords) {
  expect_named(run_b3dgs({"2", "kill0:exchange"}), 128 + SIGKILL, 1, std::string("error: rank 0 of 2 ") + kVanished,
               "error: rank 0 of 2 was killed by signal 9 (Killed)\n");
}

TEST(FailingRank, ThrowsWhileOthersExchangeRecords) {
  expect_named(run_b3dgs({"2", "throw:exchange"}), 2, 1, "error: rank 1 of 2 stopped: the disk is full\n",
               "error: the disk is full\n");
}

TEST(FailingRank, ThrowsWhileOthersExchangeTensors) {
  expect_named(run_b3dgs({"3", "throw:tensors"}), 2, 2, "error: rank 2 of 3 stopped: the disk is full\n",
               "error: the disk is full\n");
}

TEST(FailingRank, EndsOthersThatExchangeThroughRankZero) {
  const Variables relay{{"TEST_RELAY", "1"}};
  expect_named(run_b3dgs({"3", "throw:tensors"}), 2, 2, "error: rank 2 of 3 stopped: the disk is full\n",
               "error: the disk is full\n");
  expect_named(run_b3dgs({"3", "kill:tensors"}), 128 + SIGKILL, 2, std::string("error: rank 2 of 3 ") + kVanished,
               "error: rank 2 of 3 was killed by signal 9 (Killed)\n");
}

TEST(FailingRank, EndsOthersThatAreStuckElsewhere) {
  const Variables limits{{"TEST_STUCK_MS", "100"}};
  expect_named(run_b3dgs({"2", "throw:elsewhere"}), 2, 1, "error: rank 1 of 2 stopped: the disk is full\n",
               "error: the disk is full\n");
}

TEST(FailingRank, SaysNothingAnyMore) {
  const Variables limits{{"TEST_SILENCE_MS", "5000"}, {"TEST_GRACE_MS", "1000"}};
  const Outcome outcome = run_b3dgs({"2", "silent:tensors"});
  EXPECT_EQ(outcome.exit_code, PeerError::kExitCode);
  EXPECT_EQ(outcome.err,
            "error: rank 1 of 2 stopped: no sign of life for 5 s\n"
            "error: rank 1 of 2 was killed: it still ran 1 s after another one had failed\n");
}

TEST(FailingRank, ExitStatusIsThatOfTheProgram) {
  const Outcome outcome = run_b3dgs({"2", "exit:tensors"});
  EXPECT_EQ(outcome.exit_code, 3);
  EXPECT_EQ(count_of(outcome.err, kVanished), 1) << outcome.err;
}

TEST(StartOfRanks, RefusesAnotherWorldSize) {
  const Outcome outcome = run_b3dgs({"2", "wrong size"});
  EXPECT_EQ(outcome.exit_code, 2);
  EXPECT_EQ(count_of(outcome.err, "the ranks disagree on their number: WORLD_SIZE is 2 on rank 0 and 3 on rank 1"), 2)
      << outcome.err;
}

TEST(StartOfRanks, NamesRanksThatAreMissing) {
  const Variables limits{{"TEST_JOIN_MS", "3000"}};
  const Outcome outcome = run_b3dgs({"2", "missing"});
  EXPECT_EQ(outcome.exit_code, PeerError::kExitCode);
  EXPECT_EQ(outcome.err,
            "error: rank 1 of 2 stopped: did not join within 3 s (missing: 1; is the number of ranks, WORLD_SIZE, "
            "right?)\n");
}

TEST(StartOfRanks, NamesAnOccupiedPort) {
  const Socket occupied = listen_at("127.0.0.1", 0);
  const std::string port = std::to_string(port_of(occupied));
  const Variables variables{
      {"RANK", "0"}, {"WORLD_SIZE", "2"}, {"LOCAL_RANK", "0"}, {"MASTER_ADDR", "127.0.0.1"}, {"MASTER_PORT", port}};
  const Outcome outcome = run_b3dgs({"2", "collectives"});
  EXPECT_EQ(outcome.exit_code, 2);
  EXPECT_EQ(outcome.err, "error: port " + port +
                             " of 127.0.0.1 is occupied; set MASTER_PORT to a free port (torchrun: --master-port)\n");
}

/// Returns whether `n` files in the folder end in `suffix`.
bool has_files(const std::filesystem::path& folder, const std::string& suffix, int n) {
  const std::filesystem::directory_iterator files(folder);
  return n ==
         std::count_if(begin(files), end(files), [&](const auto& file) { return file.path().extension() == suffix; });
}

TEST(StartOfRanks, PassesSignalsOn) {
  const test::TempDir folder;
  test::RunOptions options;
  options.signal = SIGTERM;
  options.signal_when = [&] { return has_files(folder.path(), ".ready", 2); };
  const Outcome outcome = run_b3dgs({"2", "wait:" + folder.path().string()}, options);
  EXPECT_EQ(outcome.exit_code, 128 + SIGTERM);
  EXPECT_EQ(outcome.err, "");
  EXPECT_TRUE(has_files(folder.path(), ".stopped", 2));
}

TEST(StartOfRanks, EndsRanksWithTheLauncher) {
  const test::TempDir folder;
  test::RunOptions options;
  options.signal = SIGKILL;
  options.signal_when = [&] { return has_files(folder.path(), ".ready", 2); };
  const Outcome outcome = run_b3dgs({"2", "wait:" + folder.path().string()}, options);
  EXPECT_EQ(outcome.exit_code, 128 + SIGKILL);
  for (int i = 0; i < 6000 && !has_files(folder.path(), ".stopped", 2); ++i) {
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  EXPECT_TRUE(has_files(folder.path(), ".stopped", 2));
}

}  // namespace
}  // namespace b3dgs
