// The forward kernels of the CPU, generated from the table in forward_kernel.h; each is defined in forward_ID.cpp.
#pragma once

#include <array>

#include "raster/args.h"
#include "raster/forward_kernel.h"

namespace b3dgs::cpu {

#define B3DGS_ROW(kernel, id, name, is_balanced, summary) void blend_forward_##id(const BlendForwardArgs& args);
B3DGS_FORWARD_KERNELS(B3DGS_ROW)
#undef B3DGS_ROW

struct ForwardRow {
  ForwardKernel kernel;
  void (*blend)(const BlendForwardArgs& args);
};

/// Indexed by ForwardKernel.
inline constexpr std::array kForwardTable{
#define B3DGS_ROW(kernel, id, name, is_balanced, summary) ForwardRow{ForwardKernel::kernel, blend_forward_##id},
    B3DGS_FORWARD_KERNELS(B3DGS_ROW)
#undef B3DGS_ROW
};

}  // namespace b3dgs::cpu
