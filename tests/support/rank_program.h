// What test programs of several ranks have in common: their start, and how they say that an expectation failed.
#pragma once

#include <torch/types.h>

#include <functional>
#include <string>
#include <vector>

#include "dist/communicator.h"
#include "dist/launch/start_ranks.h"

namespace b3dgs::test {

/// @throws LogicError unless the condition holds: the rank fails, and tells the others
void expect(bool condition, const std::string& what);

/// Whether the tensors have the same bytes, whatever their types and shapes. Contiguous, on the CPU.
bool same_bytes(const torch::Tensor& a, const torch::Tensor& b);

/// Thrown by a rank to end with this exit code.
struct Exit {
  int code = 0;
};

struct RankProgram {
  int size = 1;
  std::vector<std::string> arguments;             // of this program, for the ranks that it starts
  std::function<void(Communicator& ranks)> body;  // of each rank
  StartOptions start{};
  RankLimits limits{};
};

/// The device is that of the environment variable TEST_DEVICE: "cuda" (number 0, which all ranks share), otherwise the
/// CPU. With TEST_RELAY, tensors go through rank 0 in any case. Without the environment of a launcher: starts the
/// ranks. Otherwise this process is one of them: calls body(), and prints "ok RANK" after it. Returns the exit code.
/// @throws what body() throws
int run_rank_program(const RankProgram& program);

/// Calls run() for the exit code; prints an exception as one line and returns its exit code.
int report_errors(const std::function<int()>& run);

/// main() of a program PROGRAM RANKS SCENARIO[,SCENARIO...]: each rank calls run(SCENARIO, ranks) for one after the
/// other, with the same random numbers.
int run_scenarios(int argc, char** argv, void (*run)(const std::string& scenario, Communicator& ranks));

}  // namespace b3dgs::test
