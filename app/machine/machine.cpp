#include "app/machine/machine.h"

#include <torch/version.h>
#include <unistd.h>

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
namespace {

/// The first "model name" in /proc/cpuinfo; empty if there is none.
std::string cpu_name() {
  std::ifstream file("/proc/cpuinfo");
  for (std::string line; std::getline(file, line);) {
    const std::size_t colon = line.find(": ");
    if (line.rfind("model name", 0) == 0 && colon != std::string::npos) return line.substr(colon + 2);
  }
  return "";
}

#if B3DGS_HAS_CUDA
/// Version of the kernel module, "570.86.15"; empty if unknown.
std::string driver_version() {
  std::ifstream file("/proc/driver/nvidia/version");
  std::string line;
  std::smatch match;
  std::getline(file, line);
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
#endif

}  // namespace

nlohmann::ordered_json describe_machine(const torch::Device& device) {
  nlohmann::ordered_json machine;
  machine["program"] = std::string("b3dgs ") + version();
  if (const std::string name = cpu_name(); !name.empty()) machine["cpu"] = name;
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
