// Benchmarks of the passes of one view, on the CPU or a GPU.
#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "app/bench/bench_report.h"
#include "app/bench/bench_scenes.h"

namespace b3dgs {

/// Times of all forward kernels, in the order of kForwardKernels, and statistics of the tiles' lists.
struct ForwardTimes {
  struct Row {
    std::string kernel;
    Timing timing;
  };
  std::string device;            // "CPU, 8 threads" or the GPU's name
  nlohmann::ordered_json lists;  // list_statistics()
  std::vector<Row> rows;
};

/// What --device auto selects: "cuda" if this build has CUDA kernels and the machine has a GPU, else "cpu".
std::string default_bench_device();

/// Times kernels and passes on run.device; prints each row of the tables when it is known and adds it to `file`.
/// @throws InputError if run.device does not exist or this build does not support it
void bench_kernels(const BenchRun& run, const BenchScene& scene, BenchFile& file);

/// Prints nothing. @throws InputError as bench_kernels() does
ForwardTimes time_forward_kernels(const BenchRun& run, const BenchScene& scene);

// Implementations for each device.
void bench_kernels_cpu(const BenchRun& run, const BenchScene& scene, BenchFile& file);
void bench_kernels_cuda(const BenchRun& run, const BenchScene& scene, BenchFile& file);
bool has_gpu();
ForwardTimes time_forward_kernels_cpu(const BenchRun& run, const BenchScene& scene);
ForwardTimes time_forward_kernels_cuda(const BenchRun& run, const BenchScene& scene);

}  // namespace b3dgs
