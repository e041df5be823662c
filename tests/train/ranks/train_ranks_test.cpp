// Rows, row edits, splats, noise and whole trainings on several ranks have the bytes of one rank: train_rank.cpp and
// train_together.cpp in real processes.
#include <gtest/gtest.h>

#include <string>
#include <tuple>

#include "support/run_program.h"
#include "support/variables.h"

namespace b3dgs {
namespace {

class TrainRanks : public testing::TestWithParam<std::tuple<int, const char*>> {};

void expect_success(const std::string& program, int size, const char* scenario) {
  test::RunOptions options;
  options.program = program;
  const test::Outcome outcome = test::run_b3dgs({std::to_string(size), scenario}, options);
  EXPECT_EQ(outcome.exit_code, 0) << outcome.err;
  EXPECT_EQ(outcome.err, "");
  for (int rank = 0; rank < size; ++rank) {
    EXPECT_NE(outcome.out.find("ok " + std::to_string(rank) + "\n"), std::string::npos) << outcome.out;
  }
}

TEST_P(TrainRanks, ComputeTheBytesOfOneRank) {
  expect_success(B3DGS_PROGRAM, std::get<0>(GetParam()), std::get<1>(GetParam()));
}

class TrainTogether : public TrainRanks {};

TEST_P(TrainTogether, GivesTheFilesOfOneProcess) {
  expect_success(B3DGS_TRAIN_TOGETHER, std::get<0>(GetParam()), std::get<1>(GetParam()));
}

class TrainThroughRankZero : public TrainRanks {};

TEST_P(TrainThroughRankZero, GivesTheFilesOfOneProcess) {
  const test::Variables relay{{"TEST_RELAY", "1"}};
  expect_success(B3DGS_TRAIN_TOGETHER, std::get<0>(GetParam()), std::get<1>(GetParam()));
}

std::string name_of(const testing::TestParamInfo<std::tuple<int, const char*>>& test) {
  return std::get<1>(test.param) + std::to_string(std::get<0>(test.param));
}

INSTANTIATE_TEST_SUITE_P(Ranks, TrainRanks,
                         testing::Combine(testing::Values(1, 2, 3, 4), testing::Values("gathering", "moving", "edits",
                                                                                       "splats", "noise", "misfits")),
                         name_of);

INSTANTIATE_TEST_SUITE_P(Ranks, TrainTogether,
                         testing::Combine(testing::Values(2, 3, 4),
                                          testing::Values("default", "mcmc", "budget", "options", "parts", "few",
                                                          "empty", "resume", "invalid", "stop", "appearance", "poses",
                                                          "memory", "exhausted", "failure", "scenes")),
                         name_of);

INSTANTIATE_TEST_SUITE_P(Ranks, TrainThroughRankZero,
                         testing::Combine(testing::Values(2, 3), testing::Values("budget", "parts", "failure")),
                         name_of);

}  // namespace
}  // namespace b3dgs
