// Simulates a lack of memory: a MemorySource with a limit and failures, and failures of LibTorch's allocator.
#pragma once

#include <c10/core/CPUAllocator.h>

#include <algorithm>
#include <cstring>
#include <functional>
#include <limits>
#include <utility>

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

/// LibTorch's CPU allocator, except that allocations for which `fails` returns true fail.
class FailingAllocator final : public c10::Allocator {
 public:
  explicit FailingAllocator(std::function<bool(std::size_t n_bytes)> fails) : fails_(std::move(fails)) {
    c10::SetCPUAllocator(this, kPriority);
  }
  ~FailingAllocator() override { c10::SetCPUAllocator(own_, kPriority); }
  // Some versions of LibTorch have the first of these, others the next two.
  c10::DataPtr allocate(std::size_t n_bytes) const { return take(n_bytes); }
  c10::DataPtr allocate(std::size_t n_bytes) { return take(n_bytes); }
  void copy_data(void* to, const void* from, std::size_t n_bytes) const { std::memcpy(to, from, n_bytes); }
  c10::DeleterFnPtr raw_deleter() const override { return own_->raw_deleter(); }

 private:
  static constexpr std::uint8_t kPriority = 255;
  c10::DataPtr take(std::size_t n_bytes) const {
    if (!fails_(n_bytes)) return own_->allocate(n_bytes);
    throw c10::OutOfMemoryError({__func__, __FILE__, __LINE__}, "the test has no memory for that");
  }
  c10::Allocator* const own_ = c10::GetCPUAllocator();
  const std::function<bool(std::size_t n_bytes)> fails_;
};

/// Fails the allocation that comes after `n` others. -1 means none.
struct FailOnce {
  std::int64_t n = -1;
  bool has_failed = false;

  bool operator()() {
    if (n < 0 || n-- > 0) return false;
    return has_failed = true;
  }
};

}  // namespace b3dgs::test
