#include "train/threads.h"

#include <ATen/Parallel.h>

#include "core/parallel.h"

namespace b3dgs {

void set_compute_threads(int n) {
  set_thread_count(n);
  at::set_num_threads(thread_count());
}

}  // namespace b3dgs
