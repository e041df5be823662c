// Describes this machine, for results that contain times.
#pragma once

#include <torch/types.h>
#include <nlohmann/json.hpp>

namespace b3dgs {

/// Returns data to store with measured times. Keys: "program", "cpu", "cores" (logical), "memory_gb", "libtorch",
/// "device"; if `device` is a GPU also "gpu", "gpu_memory_gb", "driver" and "cuda". Unknown values are omitted.
nlohmann::ordered_json describe_machine(const torch::Device& device);

}  // namespace b3dgs
