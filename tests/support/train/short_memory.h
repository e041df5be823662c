// A MemorySource with a limit and failures set by a test.
#pragma once

#include <algorithm>
#include <limits>

#include "train/memory/memory.h"

namespace b3dgs::test {

class ShortMemory final : public MemorySource {
 public:
  std::optional<std::int64_t> bytes;
  int n_failures = 0;                                                     // number of allocations that will fail
  std::int64_t rows_that_fit = std::numeric_limits<std::int64_t>::max();  // larger tensors cannot be allocated
  int n_releases = 0, n_requests = 0;

  std::optional<std::int64_t> limit() override { return bytes; }
  MemoryUse use() override { return {}; }
  void release_unused() override { ++n_releases; }
  torch::Tensor allocate(torch::IntArrayRef sizes, const torch::TensorOptions& options) override {
    ++n_requests;
    const bool is_too_much = sizes.size() > 1 && sizes[0] > rows_that_fit;
    if (is_too_much || n_failures > 0) {
      n_failures = std::max(0, n_failures - 1);
      throw OutOfMemoryError("the test has no memory for that");
    }
    return torch::empty(sizes, options);
  }
};

}  // namespace b3dgs::test
