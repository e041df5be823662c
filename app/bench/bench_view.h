// Benchmarks of the kernels and the passes of one view, run by the rasterizer that training uses.
#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "app/bench/bench_report.h"
#include "app/bench/bench_scenes.h"

namespace b3dgs {

/// Prints tables of kernels and passes on run.device, a row when it is known, and adds them to `file`.
/// @throws InputError if this build or machine lacks the device, or the device has no kernels for the tile size
void bench_kernels(const BenchRun& run, const BenchScene& scene, BenchFile& file);

struct ForwardTimes {
  std::string device;            // "CPU, 8 threads" or the GPU's name
  nlohmann::ordered_json lists;  // list_statistics()
  std::vector<Timing> kernels;   // in the order of kForwardKernels
};

/// Prints nothing. @throws InputError as bench_kernels() does
ForwardTimes time_forward_kernels(const BenchRun& run, const BenchScene& scene);

}  // namespace b3dgs
