// The yardstick of the CPU benchmark: what a plain tiled renderer does. One thread, one pixel at a time, the natural
// form of the exponent, libm's exp.
#pragma once

#include "raster/args.h"

namespace b3dgs {

void blend_forward_scalar_loop(const BlendForwardArgs& args);

}  // namespace b3dgs
