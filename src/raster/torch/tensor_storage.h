// Tensors whose size changes from view to view (photographs of different sizes, a growing model), in memory that only
// grows, so that steps do not allocate.
#pragma once

#include <torch/types.h>

namespace b3dgs {

/// Makes `tensor` a view of the beginning of `storage`, with these sizes and undefined contents, unless it already has
/// them. `storage` is a flat tensor; if it is too small, it is replaced by one with 1/spare_part more elements than
/// needed (0: exactly as many).
inline void place_tensor(torch::Tensor& tensor, torch::Tensor& storage, torch::IntArrayRef sizes,
                         const torch::TensorOptions& options, std::int64_t spare_part = 0) {
  if (tensor.defined() && tensor.sizes() == sizes && tensor.dtype() == options.dtype() &&
      tensor.device() == options.device()) {
    return;
  }
  std::int64_t n = 1;
  for (const std::int64_t size : sizes) n *= size;
  if (!storage.defined() || storage.numel() < n || storage.dtype() != options.dtype() ||
      storage.device() != options.device()) {
    tensor = storage = torch::Tensor();  // free it before allocating more
    storage = torch::empty({n + (spare_part > 0 ? n / spare_part : 0)}, options);
  }
  tensor = storage.slice(0, 0, n).view(sizes);
}

}  // namespace b3dgs
