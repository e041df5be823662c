// The iterations of a step. An iteration is one photograph, and a step takes --batch of them, so that every schedule
// keeps its meaning.
#pragma once

#include <algorithm>

namespace b3dgs {

/// Largest number of views of a step.
inline constexpr int kMaxBatch = 32;

/// Returns the last iteration of the step that follows `iteration`. Steps end at multiples of `batch`, wherever a
/// training was stopped and resumed, and at the last of all iterations.
inline int step_end(int batch, int iterations, int iteration) {
  const int end = batch > 1 ? (iteration / batch + 1) * batch : iteration + 1;
  return std::max(iteration + 1, std::min(end, iterations));
}

}  // namespace b3dgs
