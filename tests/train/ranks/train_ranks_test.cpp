// Tests that rows, row edits, splats, noise and whole trainings on several ranks have the bytes of one rank. Runs
// train_rank.cpp and train_together.cpp in real processes.
#include <gtest/gtest.h>

#include <algorithm>
#include <string>

#include "support/run_program.h"
#include "support/variables.h"

namespace b3dgs {
namespace {

struct Run {
  int size = 1;  // ranks
  const char* scenarios = "";
};

std::string name_of(const testing::TestParamInfo<Run>& info) {
  std::string name = info.param.scenarios;
  std::replace(name.begin(), name.end(), ',', '_');
  return name + std::to_string(info.param.size);
}

void expect_success(const std::string& program, const Run& run) {
  test::RunOptions options;
  options.program = program;
  const test::Outcome outcome = test::run_b3dgs({std::to_string(run.size), run.scenarios}, options);
  EXPECT_EQ(outcome.exit_code, 0) << outcome.err;
  EXPECT_EQ(outcome.err, "");
  for (int rank = 0; rank < run.size; ++rank) {
    EXPECT_NE(outcome.out.find("ok " + std::to_string(rank) + "\n"), std::string::npos) << outcome.out;
  }
}

class TrainRanks : public testing::TestWithParam<Run> {};

TEST_P(TrainRanks, ComputeTheBytesOfOneRank) {
  expect_success(B3DGS_PROGRAM, GetParam());
}

class TrainTogether : public TrainRanks {};

TEST_P(TrainTogether, GivesTheFilesOfOneProcess) {
  expect_success(B3DGS_TRAIN_TOGETHER, GetParam());
}

class TrainThroughRankZero : public TrainRanks {};

TEST_P(TrainThroughRankZero, GivesTheFilesOfOneProcess) {
  const test::Variables relay{{"TEST_RELAY", "1"}};
  expect_success(B3DGS_TRAIN_TOGETHER, GetParam());
}

// Processes take a second to start, so each start runs several scenarios, as far as one can follow another.
constexpr char kRows[] = "gathering,edits,splats,noise,misfits";

// One rank, which copies nothing, a pair, and a number that is not a power of two, with which some ranks render no
// view.
INSTANTIATE_TEST_SUITE_P(Ranks, TrainRanks, testing::Values(Run{1, kRows}, Run{2, kRows}, Run{3, kRows}), name_of);

INSTANTIATE_TEST_SUITE_P(
    Ranks, TrainTogether,
    testing::Values(Run{2, "everything"},  // a row of the model on either side
                    Run{4, "everything"},  // some ranks have no view in the last step
                    Run{3, "parts,panoramas,few,empty,invalid,stop"},
                    Run{2, "memory,panoramas,exhausted,packing"},  // one rank lacks memory that the other has
                    Run{3, "failure"},                             // two other ranks learn of it
                    Run{3, "loss,evaluation"}, Run{3, "scenes"}),
    name_of);

INSTANTIATE_TEST_SUITE_P(Ranks, TrainThroughRankZero, testing::Values(Run{3, "parts"}), name_of);

}  // namespace
}  // namespace b3dgs
