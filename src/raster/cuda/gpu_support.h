// Checks whether this build has code for a GPU. Plain C++, so the tests of its messages do not need CUDA.
#pragma once

#include <string>
#include <vector>

#include "core/check.h"

namespace b3dgs::cuda {

struct GpuSupport {
  std::string name;
  int capability = 0;              // compute capability: 10 * major + minor
  std::vector<int> architectures;  // compute capabilities that the kernels were compiled for
  bool has_code = true;            // the driver found kernel code that this GPU can run
};

/// Queries the current GPU, which must exist. @throws Error if the driver reports an error
GpuSupport query_gpu_support();

/// @throws InputError if this build has no code for the GPU
inline void require_support(const GpuSupport& gpu) {
  if (gpu.has_code) return;
  const auto version = [](int capability) {
    return std::to_string(capability / 10) + "." + std::to_string(capability % 10);
  };
  std::string built_for;
  for (const int architecture : gpu.architectures) built_for += (built_for.empty() ? "" : ", ") + version(architecture);
  input_error("--device cuda: ", gpu.name, " has compute capability ", version(gpu.capability),
              ", this build has code for ", built_for, "; build with -DCMAKE_CUDA_ARCHITECTURES=", gpu.capability,
              ", or use --device cpu");
}

}  // namespace b3dgs::cuda
