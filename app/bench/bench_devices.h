// The benchmarks of one view, on the CPU or a GPU.
#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "app/bench/bench_report.h"
#include "app/bench/bench_scenes.h"

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

/// "cuda" if this build has CUDA kernels and the machine a GPU, else "cpu": what --device auto takes.
std::string default_bench_device();

/// Prints the tables of kernels and passes on run.device, row by row, and adds their figures to `file`.
/// @throws InputError if there is no such device, or this build cannot use it
void bench_kernels(const BenchRun& run, const BenchScene& scene, BenchFile& file);

/// Prints nothing. @throws as bench_kernels
ForwardTimes time_forward_kernels(const BenchRun& run, const BenchScene& scene);

// Each device's own.
void bench_kernels_cpu(const BenchRun& run, const BenchScene& scene, BenchFile& file);
void bench_kernels_cuda(const BenchRun& run, const BenchScene& scene, BenchFile& file);
bool has_gpu();
ForwardTimes time_forward_kernels_cpu(const BenchRun& run, const BenchScene& scene);
ForwardTimes time_forward_kernels_cuda(const BenchRun& run, const BenchScene& scene);

}  // namespace b3dgs
