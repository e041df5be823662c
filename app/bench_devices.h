// The benchmark of one device. Each prints its tables and returns the figures.
#pragma once

#include <nlohmann/json.hpp>

#include "app/bench_scenes.h"

namespace b3dgs {

nlohmann::ordered_json bench_cpu(const BenchConfig& config, const BenchScene& scene);

/// Only in builds with CUDA. @throws InputError if there is no GPU
nlohmann::ordered_json bench_cuda(const BenchConfig& config, const BenchScene& scene);

}  // namespace b3dgs
