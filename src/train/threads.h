// One number of threads for everything that computes.
#pragma once

namespace b3dgs {

/// Threads of our own loops (parallel.h) and of LibTorch's; 0 takes all cores. LibTorch, unless told, sets OpenMP's
/// number to its own idea at its first operation, which may be half the cores: programs that use torch call this, not
/// set_thread_count().
void set_compute_threads(int n);

}  // namespace b3dgs
