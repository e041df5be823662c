#include "app/common/torch/machine.h"

#include <torch/version.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <regex>
#include <string>
#include <thread>

#include "core/version.h"
#include "train/device.h"
#if B3DGS_HAS_CUDA
#include <cuda_runtime.h>
#endif

namespace b3dgs {
#if B3DGS_HAS_CUDA
namespace {

/// Returns the version of the kernel module, "570.86.15", or "" if unknown.
std::string driver_version() {
  std::ifstream file("/proc/driver/nvidia/version");
  std::string line;
  std::smatch match;
  std::getline(file, line);
  line.resize(std::min<std::size_t>(line.size(), 256));  // std::regex recurses for each character
  return std::regex_search(line, match, std::regex(R"(\b\d{3,}\.\d+(\.\d+)?\b)")) ? match.str() : "";
}

std::string cuda_version(int version) {
  return std::to_string(version / 1000) + "." + std::to_string(version % 1000 / 10);
}

void describe_gpu(nlohmann::ordered_json& machine) {
  cudaDeviceProp properties{};
  if (cudaGetDeviceProperties(&properties, 0) == cudaSuccess) {
    machine["gpu"] = properties.name;
    machine["gpu_memory_gb"] = std::round(static_cast<double>(properties.totalGlobalMem) / 1e9);
  }
  if (const std::string driver = driver_version(); !driver.empty()) machine["driver"] = driver;
  int version = 0;
  if (cudaRuntimeGetVersion(&version) == cudaSuccess && version > 0) machine["cuda"] = cuda_version(version);
}

}  // namespace
#endif

nlohmann::ordered_json describe_machine(const torch::Device& device) {
  nlohmann::ordered_json machine;
  machine["program"] = std::string("b3dgs ") + version();
  machine["cpu"] = device_model(torch::kCPU);
  machine["cores"] = std::thread::hardware_concurrency();
  const long pages = sysconf(_SC_PHYS_PAGES), page_bytes = sysconf(_SC_PAGESIZE);
  if (pages > 0 && page_bytes > 0) {
    machine["memory_gb"] = std::round(static_cast<double>(pages) * static_cast<double>(page_bytes) / 1e9);
  }
  machine["libtorch"] = TORCH_VERSION;
  machine["device"] = device_name(device);
#if B3DGS_HAS_CUDA
  if (device.is_cuda()) describe_gpu(machine);
#endif
  return machine;
}

}  // namespace b3dgs
