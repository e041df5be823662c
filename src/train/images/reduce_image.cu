// The area filter, one thread per reduced pixel: it reads the photograph once, a few microseconds.

#include "core/cuda_rows.cuh"
#include "train/images/reduce_image_cuda.h"

namespace b3dgs::cuda {
namespace {

constexpr int kThreads = 128;

__global__ void __launch_bounds__(kThreads) reduce_image_kernel(const ReduceImageArgs args) {
  const std::int64_t i = own_row<kThreads>();
  const std::int32_t width = args.reduced_width();
  if (i >= std::int64_t{width} * args.reduced_height()) return;
  reduce_pixel(args, static_cast<std::int32_t>(i % width), static_cast<std::int32_t>(i / width));
}

}  // namespace

void reduce_image(const ReduceImageArgs& args, cudaStream_t stream) {
  launch_rows<kThreads>(reduce_image_kernel, args, std::int64_t{args.reduced_width()} * args.reduced_height(), stream);
}

}  // namespace b3dgs::cuda
