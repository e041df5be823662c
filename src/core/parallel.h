// Parallel loops with OpenMP: over equal chunks or rows with one chunk per thread, or over tasks that threads take one
// by one. An exception in a loop body is rethrown in the caller.
#pragma once

#include <omp.h>

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <exception>

namespace b3dgs {

/// Returns the number of threads that the functions below use. set_thread_count(0) selects the number of cores.
inline int thread_count() {
  return omp_get_max_threads();
}
inline void set_thread_count(int n) {
  omp_set_num_threads(n > 0 ? n : omp_get_num_procs());
}

namespace detail {

/// Calls body(0) ... body(n - 1), each on its own thread. If OpenMP provides fewer threads, as in a nested parallel
/// region, a thread makes several of the calls.
template <class Body>
void on_threads(int n, Body&& body) {
  if (n <= 1) {
    body(0);
    return;
  }
  std::exception_ptr error;
#pragma omp parallel num_threads(n)
  {
    try {
      for (int part = omp_get_thread_num(); part < n; part += omp_get_num_threads()) body(part);
    } catch (...) {
#pragma omp critical(b3dgs_parallel_error)
      if (!error) error = std::current_exception();
    }
  }
  if (error) std::rethrow_exception(error);
}

}  // namespace detail

/// Calls body(task, thread) for every task in [0, n). Tasks are assigned dynamically, in ascending order.
template <class Body>
void parallel_pool(std::int64_t n, Body&& body) {
  std::atomic<std::int64_t> next{0};
  const int threads = static_cast<int>(std::min<std::int64_t>(thread_count(), n));
  detail::on_threads(threads, [&](int thread) {
    for (std::int64_t task = next.fetch_add(1); task < n; task = next.fetch_add(1)) body(task, thread);
  });
}

/// The range [0, n), divided into `count` nearly equal parts.
struct Chunks {
  std::int64_t n = 0, count = 0;
  std::int64_t begin(std::int64_t chunk) const { return n * chunk / count; }
  std::int64_t end(std::int64_t chunk) const { return n * (chunk + 1) / count; }
};

/// Makes one chunk per thread, or fewer so that each has at least `grain` elements.
inline Chunks make_chunks(std::int64_t n, std::int64_t grain) {
  const std::int64_t most = std::max<std::int64_t>(1, n / std::max<std::int64_t>(1, grain));
  return {n, std::min<std::int64_t>(thread_count(), most)};
}

/// Calls body(begin, end) once for each chunk of [0, n).
template <class Body>
void parallel_chunks(std::int64_t n, std::int64_t grain, Body&& body) {
  if (n <= 0) return;
  const Chunks chunks = make_chunks(n, grain);
  detail::on_threads(static_cast<int>(chunks.count), [&](int chunk) { body(chunks.begin(chunk), chunks.end(chunk)); });
}

/// Calls body(i) for each i in [0, n), a chunk per thread.
template <class Body>
void parallel_each(std::int64_t n, std::int64_t grain, Body&& body) {
  parallel_chunks(n, grain, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i) body(i);
  });
}

/// Calls row(args, i) for each i in [0, n).
template <auto row, class Args>
void for_rows(const Args& args, std::int64_t n) {
  constexpr std::int64_t kGrain = 1024;
  parallel_each(n, kGrain, [&](std::int64_t i) { row(args, i); });
}

}  // namespace b3dgs
