#include "support/rank_program.h"

#include <torch/utils.h>

#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <optional>
#include <sstream>

#include "core/check.h"

namespace b3dgs::test {

void expect(bool condition, const std::string& what) {
  if (!condition) throw LogicError("expectation failed: " + what);
}

bool same_bytes(const torch::Tensor& a, const torch::Tensor& b) {
  return a.numel() * static_cast<std::int64_t>(a.element_size()) ==
             b.numel() * static_cast<std::int64_t>(b.element_size()) &&
         (a.numel() == 0 ||
          std::memcmp(a.data_ptr(), b.data_ptr(), static_cast<std::size_t>(a.numel()) * a.element_size()) == 0);
}

int run_rank_program(const RankProgram& program) {
  // The environment of a launcher determines the number of ranks, if there is one.
  const std::optional<RankPlace> place = choose_rank_place(std::getenv("RANK") == nullptr ? program.size : 0);
  if (!place) return start_ranks(program.size, program.arguments, program.start);
  torch::set_num_threads(1);
  const char* const device = std::getenv("TEST_DEVICE");
  const bool is_gpu = device != nullptr && std::strcmp(device, "cuda") == 0;
  const auto ranks = Communicator::connect(*place, is_gpu ? torch::Device(torch::kCUDA, 0) : torch::Device(torch::kCPU),
                                           program.limits, std::getenv("TEST_RELAY") != nullptr);
  try {
    run_as_rank(*ranks, [&] { program.body(*ranks); });
  } catch (const Exit& exit) {
    return exit.code;
  }
  std::printf("ok %d\n", ranks->rank());
  return 0;
}

int report_errors(const std::function<int()>& run) {
  try {
    return run();
  } catch (const std::exception& error) {
    const std::string line = std::string("error: ") + error.what() + "\n";
    std::fputs(line.c_str(), stderr);
    if (dynamic_cast<const PeerError*>(&error) != nullptr) return PeerError::kExitCode;
    return dynamic_cast<const InputError*>(&error) != nullptr ? 2 : 1;
  }
}

int run_scenarios(int argc, char** argv, void (*run)(const std::string& scenario, Communicator& ranks)) {
  if (argc != 3) return 2;
  const std::string scenarios = argv[2];
  RankProgram program;
  program.size = std::atoi(argv[1]);
  program.arguments = {argv[1], scenarios};
  program.body = [&](Communicator& ranks) {
    std::istringstream list(scenarios);
    for (std::string scenario; std::getline(list, scenario, ',');) {
      torch::manual_seed(11);  // so that whole tensors are the same on all ranks
      try {
        run(scenario, ranks);
      } catch (const LogicError& error) {
        throw LogicError(scenario + ": " + error.what());
      }
    }
  };
  return report_errors([&] { return run_rank_program(program); });
}

}  // namespace b3dgs::test
