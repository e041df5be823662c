// Tensors whose size changes from view to view, in memory that only grows: photographs of several sizes, or a model
// that grows, do not ask for memory in every step.
#pragma once

#include <torch/types.h>

namespace b3dgs {

/// Makes `tensor` one of these sizes, contents undefined, at the beginning of `room`: a flat tensor that is replaced
/// where it is too small, by one with 1/spare_part more than asked (0: no more). A tensor that is as asked stays.
inline void place_tensor(torch::Tensor& tensor, torch::Tensor& room, torch::IntArrayRef sizes,
                         const torch::TensorOptions& options, std::int64_t spare_part = 0) {
  if (tensor.defined() && tensor.sizes() == sizes && tensor.dtype() == options.dtype() &&
      tensor.device() == options.device()) {
    return;
  }
  std::int64_t n = 1;
  for (const std::int64_t size : sizes) n *= size;
  if (!room.defined() || room.numel() < n || room.dtype() != options.dtype() || room.device() != options.device()) {
    tensor = room = torch::Tensor();  // before more is asked for
    room = torch::empty({n + (spare_part > 0 ? n / spare_part : 0)}, options);
  }
  tensor = room.slice(0, 0, n).view(sizes);
}

}  // namespace b3dgs
