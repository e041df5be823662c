#include "train/loss/error_image.h"

#include "core/check.h"
#include "core/parallel.h"
#include "raster/torch/tensor_check.h"
#include "raster/torch/tensor_storage.h"
#include "train/loss/loss_args.h"

#if B3DGS_TORCH_CUDA
#include "raster/torch/torch_launch.h"
#include "train/loss/loss_cuda.h"
#endif

namespace b3dgs {

void ErrorImage::compute(const torch::Tensor& rendered, const torch::Tensor& truth, const torch::Tensor& valid) {
  TensorCheck(rendered.device()).dims("rendered", rendered, {"H", "W", 3});
  B3DGS_CHECK(truth.sizes() == rendered.sizes() && truth.scalar_type() == torch::kUInt8 && truth.is_contiguous(),
              "truth is ", truth.sizes(), " ", truth.scalar_type(), ", expected contiguous uint8 ", rendered.sizes());
  place_tensor(error_, room_, rendered.sizes().slice(0, 2), rendered.options());
  ErrorImageArgs args;
  args.n_pixels = error_.numel();
  args.rendered = rendered.data_ptr<float>();
  args.truth = truth.data_ptr<std::uint8_t>();
  args.valid = valid.defined() ? valid.data_ptr<std::uint8_t>() : nullptr;
  args.error = error_.data_ptr<float>();
#if B3DGS_TORCH_CUDA
  if (rendered.is_cuda()) return cuda::compute_error_image(args, torch_launch_context().stream);
#endif
  constexpr std::int64_t kGrain = 4096;
  parallel_chunks(args.n_pixels, kGrain, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t pixel = begin; pixel < end; ++pixel) args.error[pixel] = pixel_error(args, pixel);
  });
}

}  // namespace b3dgs
