// The passes of the CPU rasterizer, each a function of its arguments. rasterize_cpu.cpp calls them in this order.
#pragma once

#include <cstdint>

#include "raster/args.h"
#include "raster/cpu/buffer.h"

namespace b3dgs::cpu {

/// Returns M, the number of splats. @throws InvalidGaussianError naming the first invalid Gaussian
std::int64_t project(const ProjectArgs& args);

/// Buffers of binning, reused from view to view.
struct BinBuffers {
  Buffer<std::int64_t> tile_offsets, slot_offsets, pair_slots, tile_counts;
  Buffer<std::int32_t> splat_ids;
  Buffer<std::uint64_t> keys, keys_swap;
};
BinnedSplats bin(const BinArgs& args, BinBuffers& buffers);

/// Runs one of the kernels of forward/forward_table.h.
void blend_forward(ForwardKernel kernel, const BlendForwardArgs& args);

void count_load(const CountLoadArgs& args);

void blend_backward(const BlendBackwardArgs& args);

void project_backward(const ProjectBackwardArgs& args);

}  // namespace b3dgs::cpu
