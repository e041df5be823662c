// Rows, row edits, splats and noise on several ranks have the bytes of one rank: train_rank.cpp in real processes.
#include <gtest/gtest.h>

#include <string>
#include <tuple>

#include "support/run_program.h"

namespace b3dgs {
namespace {

class TrainRanks : public testing::TestWithParam<std::tuple<int, const char*>> {};

TEST_P(TrainRanks, ComputeTheBytesOfOneRank) {
  const auto [size, scenario] = GetParam();
  const test::Outcome outcome = test::run_b3dgs({std::to_string(size), scenario});  // runs train_rank here
  EXPECT_EQ(outcome.exit_code, 0) << outcome.err;
  EXPECT_EQ(outcome.err, "");
  for (int rank = 0; rank < size; ++rank) {
    EXPECT_NE(outcome.out.find("ok " + std::to_string(rank) + "\n"), std::string::npos) << outcome.out;
  }
}

INSTANTIATE_TEST_SUITE_P(Ranks, TrainRanks,
                         testing::Combine(testing::Values(1, 2, 3, 4),
                                          testing::Values("gathering", "edits", "splats", "noise", "misfits")),
                         [](const auto& test) {
                           return std::get<1>(test.param) + std::to_string(std::get<0>(test.param));
                         });

}  // namespace
}  // namespace b3dgs
