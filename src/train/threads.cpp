#include "train/threads.h"

#include <ATen/Parallel.h>

#include "core/parallel.h"

namespace b3dgs {
namespace {

int default_threads = 0;

}  // namespace

void set_compute_threads(int n) {
  set_thread_count(n > 0 ? n : default_threads);
  at::set_num_threads(thread_count());
}

void set_default_threads(int n) {
  default_threads = n;
}

}  // namespace b3dgs
