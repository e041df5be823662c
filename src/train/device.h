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

/// The name of the CPU or GPU, such as "NVIDIA H200", or "cpu" if it is unknown.
std::string device_model(const torch::Device& device);

/// A line for the summary of a scene: "device      CPU, 2 threads".
std::string describe_device(const torch::Device& device);

// The number of threads, for our own loops and LibTorch.

/// Sets the number of threads for our own loops (core/parallel.h) and for LibTorch, and returns it; 0 = all cores, or
/// what set_default_threads() says. It is limited to 64 or, if that is more, to four per core: thousands of threads
/// take minutes to start. Programs that use LibTorch call this instead of set_thread_count(): at its first operation
/// LibTorch would otherwise change OpenMP's number of threads, to as few as half the cores.
int set_compute_threads(int n);

/// From now on, set_compute_threads(0) sets n threads, for processes that share a machine; 0 = all cores.
void set_default_threads(int n);

}  // namespace b3dgs
