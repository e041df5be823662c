// Shared by test programs of several ranks: their start, and the report of a failed expectation.
#pragma once

#include <torch/types.h>

#include <functional>
#include <string>
#include <vector>

#include "dist/communicator.h"
#include "dist/launch/start_ranks.h"

namespace b3dgs::test {

/// @throws LogicError unless the condition is true; the rank fails, and tells the others
void expect(bool condition, const std::string& what);

/// Returns whether two contiguous CPU tensors have the same bytes, whatever their types and shapes.
bool same_bytes(const torch::Tensor& a, const torch::Tensor& b);

/// Thrown by a rank to end with this exit code.
struct Exit {
  int code = 0;
};

struct RankProgram {
  int size = 1;
  std::vector<std::string> arguments;             // arguments of this program, for the ranks that it starts
  std::function<void(Communicator& ranks)> body;  // body of each rank
  StartOptions start{};
  RankLimits limits{};
};

/// Starts the ranks if there is no environment of a launcher. Otherwise this process is a rank: calls body(), and then
/// prints "ok RANK". Returns the exit code. The device comes from the environment variable TEST_DEVICE: "cuda" (number
/// 0, which all ranks share), otherwise the CPU. With TEST_RELAY, tensors always go through rank 0.
/// @throws what body() throws
int run_rank_program(const RankProgram& program);

/// Calls run() for the exit code. Prints an exception as one line and returns its exit code.
int report_errors(const std::function<int()>& run);

/// Implements main() of a program PROGRAM RANKS SCENARIO[,SCENARIO...]. Each rank calls run(SCENARIO, ranks) for one
/// scenario after the other, with the same random numbers.
int run_scenarios(int argc, char** argv, void (*run)(const std::string& scenario, Communicator& ranks));

}  // namespace b3dgs::test
