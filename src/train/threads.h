// The number of threads, for our own loops and LibTorch.
#pragma once

namespace b3dgs {

/// Sets the number of threads for our own loops (core/parallel.h) and for LibTorch, and returns it; 0 = all cores, or
/// what set_default_threads() says. It is limited to 64 or, if that is more, to four per core: thousands of threads
/// take minutes to start. Programs that use LibTorch call this instead of set_thread_count(): at its first operation
/// LibTorch would otherwise change OpenMP's number of threads, to as few as half the cores.
int set_compute_threads(int n);

/// From now on, set_compute_threads(0) sets n threads, for processes that share a machine; 0 = all cores.
void set_default_threads(int n);

}  // namespace b3dgs
