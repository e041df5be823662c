// Tests the launcher of ranks on one machine, with shells as ranks.
#include <gtest/gtest.h>

#include <csignal>
#include <string>

#include "dist/launch/start_ranks.h"
#include "support/files.h"
#include "support/temp_dir.h"

namespace b3dgs {
namespace {

struct Ended {
  int status;
  std::string err;
};

Ended run_shells(int size, const std::string& script, std::chrono::milliseconds grace = std::chrono::minutes(1)) {
  StartOptions options;
  options.program = "/bin/sh";
  options.grace = grace;
  testing::internal::CaptureStderr();
  const int status = start_ranks(size, {"-c", script}, options);
  return {status, testing::internal::GetCapturedStderr()};
}

TEST(StartRanks, TellsEachItsPlace) {
  const test::TempDir folder;
  const std::string file = (folder.path() / "$RANK").string();
  const Ended ended = run_shells(
      3, "echo $RANK/$WORLD_SIZE $LOCAL_RANK $MASTER_ADDR $B3DGS_JOB $MASTER_PORT > " + file + "; cat >> " + file);
  EXPECT_EQ(ended.status, 0);
  EXPECT_EQ(ended.err, "");
  const std::string first = test::read_bytes((folder.path() / "0").string());
  EXPECT_EQ(first.substr(0, 16), "0/3 0 127.0.0.1 ");
  for (const char* const rank : {"1", "2"}) {
    const std::string text = test::read_bytes((folder.path() / rank).string());
    EXPECT_EQ(text, std::string(rank) + "/3 " + rank + first.substr(5)) << "the same job, address and port";
  }
  EXPECT_GT(first.size(), 16u + 32u) << "a job that nobody guesses";
}

TEST(StartRanks, OnlyRankZeroHasTheSocket) {
  // ls -l shows the target of the descriptor.
  EXPECT_EQ(run_shells(2,
                       "if [ $RANK = 0 ]; then ls -l /proc/self/fd/$B3DGS_LISTENING_SOCKET | grep -q socket; else "
                       "[ -z \"$B3DGS_LISTENING_SOCKET\" ]; fi")
                .status,
            0);
}

TEST(StartRanks, ReturnsTheFirstFailingStatus) {
  EXPECT_EQ(run_shells(2, "exit 0").status, 0);
  EXPECT_EQ(run_shells(3, "[ $RANK = 1 ] && exit 7; exit 0").status, 7);
  const test::TempDir folder;
  const std::string gate = (folder.path() / "gate").string();
  EXPECT_EQ(run_shells(2, "if [ $RANK = 0 ]; then while [ ! -e " + gate +
                              " ]; do sleep 0.01; done; sleep 2; exit 4; "
                              "else touch " +
                              gate + "; exit 5; fi")
                .status,
            5);
}

TEST(StartRanks, PrefersTheStatusOfTheRankThatFailed) {
  const test::TempDir folder;
  const std::string gate = (folder.path() / "gate").string();
  EXPECT_EQ(run_shells(2, "if [ $RANK = 0 ]; then while [ ! -e " + gate +
                              " ]; do sleep 0.01; done; exit 2; "
                              "else touch " +
                              gate + "; exit 3; fi")
                .status,
            2)
      << "rank 1 ended first, but only because another one failed";
}

TEST(StartRanks, NamesARankThatASignalKilled) {
  const Ended ended = run_shells(2, "[ $RANK = 1 ] && kill -9 $$; exit 0");
  EXPECT_EQ(ended.status, 128 + SIGKILL);
  EXPECT_EQ(ended.err, "error: rank 1 of 2 was killed by signal 9 (Killed)\n");
}

TEST(StartRanks, KillsRanksThatOutliveAFailure) {
  const Ended ended = run_shells(2, "[ $RANK = 1 ] && exit 4; exec sleep 10000", std::chrono::milliseconds(100));
  EXPECT_EQ(ended.status, 4);
  EXPECT_EQ(ended.err, "error: rank 0 of 2 was killed: it still ran 0 s after another one had failed\n");
}

TEST(StartRanks, NamesARankThatCannotStart) {
  StartOptions options;
  options.program = "/no/such/program";
  testing::internal::CaptureStderr();
  EXPECT_EQ(start_ranks(1, {}, options), 127);
  EXPECT_EQ(testing::internal::GetCapturedStderr(), "error: rank 0 of 1 could not be started\n");
}

}  // namespace
}  // namespace b3dgs
