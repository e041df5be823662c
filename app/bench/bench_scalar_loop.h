// The baseline of the CPU benchmark: a plain tiled renderer with one thread, one pixel at a time and exp() of libm.
#pragma once

#include "raster/args.h"

namespace b3dgs {

void blend_forward_scalar_loop(const BlendForwardArgs& args);

}  // namespace b3dgs
