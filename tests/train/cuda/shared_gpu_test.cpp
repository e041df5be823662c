// Runs dist_rank.cpp and train_together.cpp as real processes that share GPU 0, with tensors on the GPU.
#include <gtest/gtest.h>

#include <string>
#include <tuple>

#include "support/gpu_test.h"
#include "support/run_program.h"
#include "support/variables.h"

namespace b3dgs {
namespace {

class SharedGpu : public testing::TestWithParam<std::tuple<int, const char*>> {
 protected:
  void expect_success(const std::string& program) const {
    B3DGS_NEEDS_GPU();
    const test::Variables device{{"TEST_DEVICE", "cuda"}};
    test::RunOptions options;
    options.program = program;
    const auto [size, scenario] = GetParam();
    const test::Outcome outcome = test::run_b3dgs({std::to_string(size), scenario}, options);
    EXPECT_EQ(outcome.exit_code, 0) << outcome.err;
    EXPECT_EQ(outcome.err, "");
    for (int rank = 0; rank < size; ++rank) {
      EXPECT_NE(outcome.out.find("ok " + std::to_string(rank) + "\n"), std::string::npos) << outcome.out;
    }
  }
};

std::string name_of(const testing::TestParamInfo<std::tuple<int, const char*>>& test) {
  return std::get<1>(test.param) + std::to_string(std::get<0>(test.param));
}

class TransferOnSharedGpu : public SharedGpu {};
TEST_P(TransferOnSharedGpu, DeliversEveryByte) {
  expect_success(B3DGS_DIST_RANK);
}

class TrainOnSharedGpu : public SharedGpu {};
TEST_P(TrainOnSharedGpu, GivesTheFilesOfOneProcess) {
  expect_success(B3DGS_PROGRAM);
}

INSTANTIATE_TEST_SUITE_P(Ranks, TransferOnSharedGpu,
                         testing::Combine(testing::Values(2, 3), testing::Values("collectives")), name_of);

INSTANTIATE_TEST_SUITE_P(Ranks, TrainOnSharedGpu,
                         testing::Values(std::tuple(2, "everything"), std::tuple(3, "everything"),
                                         std::tuple(3, "parts"), std::tuple(2, "panoramas"), std::tuple(3, "panoramas"),
                                         std::tuple(3, "failure")),
                         name_of);

}  // namespace
}  // namespace b3dgs
