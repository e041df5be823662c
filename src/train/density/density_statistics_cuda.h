// CUDA version of add_view(), without torch.
#pragma once

#include <cuda_runtime_api.h>

#include <cstdint>

namespace b3dgs::cuda {

/// As DensityStatistics and ViewStatistics; device arrays.
struct AddViewArgs {
  std::int64_t n_gaussians = 0;
  const float* means2d_grad = nullptr;    // [N, 2] 1/px
  const std::int32_t* radii = nullptr;    // [N] px, 0 = not seen
  float half_width = 0, half_height = 0;  // px, of the image
  float* grad_norm_sum = nullptr;         // [N] normalised device coordinates
  std::int32_t* view_count = nullptr;     // [N]
  std::int32_t* max_radii = nullptr;      // [N] px
};

/// Gaussians that the view does not see keep their sums. Asynchronous.
void add_view(const AddViewArgs& args, cudaStream_t stream);

}  // namespace b3dgs::cuda
