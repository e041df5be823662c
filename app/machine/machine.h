// What a figure was measured on: without it, a time says nothing.
#pragma once

#include <torch/types.h>
#include <nlohmann/json.hpp>

namespace b3dgs {

/// "program", "cpu", "cores" (logical), "memory_gb", "libtorch", "device"; of a device that is a GPU also "gpu",
/// "gpu_memory_gb", "driver" and "cuda". What the system does not tell is left out.
nlohmann::ordered_json describe_machine(const torch::Device& device);

/// The GPU's part. Only in builds with CUDA.
void describe_gpu(nlohmann::ordered_json& machine);

}  // namespace b3dgs
