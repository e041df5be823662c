// The device that training runs on.
#pragma once

#include <torch/types.h>

#include <string>

namespace b3dgs {

/// The device for `--device NAME`: "cpu", "cuda", or "auto", which is a GPU if this build and this machine support one.
/// The GPU is CUDA's current device of this thread: number 0 unless it was changed.
/// @throws InputError if "cuda" is given and there is no GPU, or if the kernels of this build cannot run on the GPU
torch::Device choose_device(const std::string& name);

/// The device's name on the command line.
std::string device_name(const torch::Device& device);

/// A line for the summary of a scene: "device      CPU, 2 threads".
std::string describe_device(const torch::Device& device);

}  // namespace b3dgs
