// The device that training runs on.
#pragma once

#include <torch/types.h>

#include <string>

namespace b3dgs {

/// Returns the device for `--device NAME`. "auto" is a GPU if this build and this machine support one, and otherwise
/// the CPU. The GPU is CUDA's current device of this thread, which is number 0 unless it was changed.
/// @throws InputError if "cuda" is given and there is no GPU, or if the kernels of this build cannot run on the GPU
torch::Device choose_device(const std::string& name);

/// Returns the device's name on the command line: "cpu" or "cuda".
std::string device_name(const torch::Device& device);

/// Returns the name of the CPU or GPU, such as "NVIDIA H200", or "cpu" if it is unknown.
std::string device_model(const torch::Device& device);

/// Returns a line for the summary of a scene: "device      CPU, 2 threads".
std::string describe_device(const torch::Device& device);

/// Sets the number of threads for our own loops (core/parallel.h) and for LibTorch, and returns it. 0 stands for all
/// cores, or for the number passed to set_default_threads(). The number is limited to 64 or to four per core, whichever
/// is more, because starting thousands of threads takes minutes.
/// Programs that use LibTorch call this instead of set_thread_count(). Otherwise LibTorch changes OpenMP's number of
/// threads at its first operation, to as few as half the cores.
int set_compute_threads(int n);

/// Sets the number of threads that set_compute_threads(0) uses, for processes that share a machine. 0 stands for all
/// cores.
void set_default_threads(int n);

}  // namespace b3dgs
