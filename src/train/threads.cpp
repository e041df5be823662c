#include "train/threads.h"

#include <ATen/Parallel.h>

#include <algorithm>

#include "core/parallel.h"

namespace b3dgs {
namespace {

int default_threads = 0;

}  // namespace

int set_compute_threads(int n) {
  constexpr int kFew = 64;  // as for a training that is resumed on a smaller machine
  set_thread_count(std::min(n > 0 ? n : default_threads, std::max(kFew, 4 * omp_get_num_procs())));
  at::set_num_threads(thread_count());
  return thread_count();
}

void set_default_threads(int n) {
  default_threads = n;
}

}  // namespace b3dgs
