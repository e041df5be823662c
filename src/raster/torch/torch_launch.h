// LibTorch's current stream and its allocator as a LaunchContext. Compiled only where both nvcc and a LibTorch with
// CUDA are there: with torch_memory.cpp the one file that includes c10's CUDA headers.
#pragma once

#include "raster/cuda/device_buffer.h"

namespace b3dgs {

/// A context on the current device and LibTorch's current stream there. Its memory comes from LibTorch's caching
/// allocator, and lives as long as the program. What does not fit is an OutOfMemoryError.
cuda::LaunchContext torch_launch_context();

}  // namespace b3dgs
