// LibTorch's current stream and caching allocator as a LaunchContext. Compiled only if both nvcc and a LibTorch with
// CUDA are available.
#pragma once

#include "raster/cuda/device_buffer.h"

namespace b3dgs {

/// A context on the current device and LibTorch's current stream. Memory comes from LibTorch's caching allocator, which
/// throws OutOfMemoryError. The allocator object lives until the program ends.
cuda::LaunchContext torch_launch_context();

}  // namespace b3dgs
