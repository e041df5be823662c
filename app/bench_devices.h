// The benchmarks of one view, on the CPU or a GPU.
#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "app/bench_report.h"
#include "app/bench_scenes.h"

namespace b3dgs {

/// The forward kernels' times, in the order of their table, and the lists that they worked through.
struct ForwardTimes {
  struct Row {
    std::string kernel;
    Timing timing;
  };
  std::string device;            // "CPU, 8 threads" or the GPU's name
  nlohmann::ordered_json lists;  // list_statistics()
  std::vector<Row> rows;
};

/// Prints the tables of kernels and passes on run.device and returns their figures.
/// @throws InputError if there is no such device, or this build cannot use it
nlohmann::ordered_json bench_kernels(const BenchRun& run, const BenchScene& scene);

/// Prints nothing. @throws as bench_kernels
ForwardTimes time_forward_kernels(const BenchRun& run, const BenchScene& scene);

// Each device's own.
nlohmann::ordered_json bench_kernels_cpu(const BenchRun& run, const BenchScene& scene);
nlohmann::ordered_json bench_kernels_cuda(const BenchRun& run, const BenchScene& scene);
ForwardTimes time_forward_kernels_cpu(const BenchRun& run, const BenchScene& scene);
ForwardTimes time_forward_kernels_cuda(const BenchRun& run, const BenchScene& scene);

}  // namespace b3dgs
