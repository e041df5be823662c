#include "train/device.h"

#include <ATen/Context.h>
#include <ATen/Parallel.h>

#include <algorithm>
#include <fstream>

#include "core/check.h"
#include "core/parallel.h"

#if B3DGS_TORCH_CUDA
#include <c10/cuda/CUDAFunctions.h>

#include "raster/cuda/gpu_support.h"
#endif

namespace b3dgs {
namespace {

int default_threads = 0;

/// Returns why no GPU can be used, or "" if one can be.
std::string why_no_gpu() {
#if B3DGS_TORCH_CUDA
  return at::hasCUDA() ? "" : "no GPU found, or its driver does not respond";
#else
  return "this build has no CUDA support (needs nvcc and a LibTorch with CUDA)";
#endif
}

}  // namespace

torch::Device choose_device(const std::string& name) {
  if (name == "cpu") return torch::kCPU;
  const std::string reason = why_no_gpu();
#if B3DGS_TORCH_CUDA
  if (reason.empty()) {
    cuda::require_support(cuda::query_gpu_support());
    return torch::Device(torch::kCUDA, c10::cuda::current_device());
  }
#endif
  if (name == "cuda") input_error("--device cuda: ", reason, "; use --device cpu");
  return torch::kCPU;
}

std::string device_name(const torch::Device& device) {
  return device.is_cuda() ? "cuda" : "cpu";
}

std::string device_model(const torch::Device& device) {
#if B3DGS_TORCH_CUDA
  if (device.is_cuda()) return cuda::query_gpu_support().name;
#endif
  std::ifstream file("/proc/cpuinfo");
  for (std::string line; std::getline(file, line);) {
    const std::size_t colon = line.find(": ");
    if (line.rfind("model name", 0) == 0 && colon != std::string::npos) return line.substr(colon + 2);
  }
  return device_name(device);
}

std::string describe_device(const torch::Device& device) {
  if (device.is_cuda()) return "device      GPU";
  const int threads = thread_count();
  return "device      CPU, " + std::to_string(threads) + (threads == 1 ? " thread" : " threads");
}

int set_compute_threads(int n) {
  constexpr int kFew = 64;  // always allowed, because a training may be resumed on a machine with fewer cores
  set_thread_count(std::min(n > 0 ? n : default_threads, std::max(kFew, 4 * omp_get_num_procs())));
  at::set_num_threads(thread_count());
  return thread_count();
}

void set_default_threads(int n) {
  default_threads = n;
}

}  // namespace b3dgs
