// Where to compute: said, never guessed.
#pragma once

#include <torch/types.h>

#include <string>

namespace b3dgs {

/// The device for `--device NAME`: "cpu", "cuda", or "auto", which takes a GPU if this build and this machine have one.
/// @throws InputError if a GPU is asked for and there is none, or if the kernels of this build cannot run on it
torch::Device choose_device(const std::string& name);

/// Its name as on the command line.
std::string device_name(const torch::Device& device);

/// A line for the summary of a scene: "device      CPU, 2 threads".
std::string describe_device(const torch::Device& device);

}  // namespace b3dgs
