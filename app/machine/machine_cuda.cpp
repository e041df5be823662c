// The part of the machine description that needs the CUDA runtime.
#include <cuda_runtime.h>

#include <cmath>
#include <fstream>
#include <regex>
#include <string>

#include "app/machine/machine.h"

namespace b3dgs {
namespace {

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

}  // namespace

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

}  // namespace b3dgs
