// Whether the kernels of this build can run on the GPU that is there. Plain C++: the message is tested without CUDA.
#pragma once

#include <string>
#include <vector>

#include "core/check.h"

namespace b3dgs::cuda {

struct GpuSupport {
  std::string name;
  int capability = 0;              // compute capability, 10 x major + minor
  std::vector<int> architectures;  // that the kernels were compiled for, likewise
  bool has_code = true;            // the driver found code of the kernels that this GPU can run
};

/// Of GPU 0, which has to be there. @throws Error if the driver does not answer
GpuSupport query_gpu_support();

/// @throws InputError if the GPU has no code to run
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
