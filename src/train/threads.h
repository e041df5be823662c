// The number of threads, for our own loops and LibTorch.
#pragma once

namespace b3dgs {

/// Sets the number of threads for our own loops (core/parallel.h) and for LibTorch; 0 = all cores, or what
/// set_default_threads() says. Programs that use
/// LibTorch call this instead of set_thread_count(): at its first operation LibTorch would otherwise change OpenMP's
/// number of threads, to as few as half the cores.
void set_compute_threads(int n);

/// From now on, set_compute_threads(0) sets n threads, for processes that share a machine; 0 = all cores.
void set_default_threads(int n);

}  // namespace b3dgs
