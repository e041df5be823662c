// The limit of host memory for the decoded photographs of a scene, and the number of bytes in use. The memory is
// divided between cached photographs and the buffers of readers that prefetch.
#pragma once

#include <algorithm>
#include <cstdint>
#include <limits>
#include <memory>
#include <mutex>

namespace b3dgs {

/// Returns the limit for --host_memory_gb, in bytes. -1 stands for 80 % of `available_bytes`.
std::int64_t image_memory_limit(double host_memory_gb, std::int64_t available_bytes);

/// Thread-safe.
class ImageMemory {
 public:
  static constexpr int kMaxBuffers = 64;  // per reader; more than a second of steps has no benefit

  struct Plan {
    std::int64_t limit = std::numeric_limits<std::int64_t>::max();
    std::int64_t photographs = 0, largest = 0;  // bytes: all together, and the largest
    std::int64_t fixed = 0;                     // bytes used regardless of the limit: masks, undistortion maps
    int n_readers = 1;                          // number that prefetch at the same time
  };

  /// Sets no limit.
  ImageMemory() = default;
  /// If not all photographs fit, readers get up to a quarter of the memory, but at least one buffer each.
  explicit ImageMemory(const Plan& plan);

  std::int64_t limit() const { return plan_.limit; }
  std::int64_t fixed() const { return locked(plan_.fixed); }
  /// Returns the number of buffers for one reader, 1 to kMaxBuffers.
  int n_buffers() const { return locked(n_buffers_); }

  /// Bytes that are in use while this exists. The ImageMemory must outlive it.
  using Use = std::shared_ptr<void>;

  /// Reserves memory for other purposes before photographs are cached. It counts as Plan::fixed. Returns null if it
  /// would leave readers less than a buffer each.
  Use reserve(std::int64_t bytes);

  /// Reserves memory for a photograph to cache. Returns false if there is not enough.
  bool try_hold(std::int64_t bytes);
  /// Undoes try_hold().
  void release_held(std::int64_t bytes);
  /// Counts the buffers of a reader, which has at most n_buffers(), each the size of the largest photograph.
  Use use_buffers(std::int64_t bytes);

  /// Returns the bytes in use, including Plan::fixed, and the maximum so far.
  std::int64_t used() const {
    const std::lock_guard<std::mutex> lock(mutex_);
    return plan_.fixed + held_ + buffers_;
  }
  std::int64_t peak() const { return locked(peak_); }

 private:
  template <class Value>
  Value locked(const Value& value) const {
    const std::lock_guard<std::mutex> lock(mutex_);
    return value;
  }
  // Changes one of the amounts below and the values that follow from them. The mutex must be locked.
  void add(std::int64_t& amount, std::int64_t bytes);
  Use use(std::int64_t& amount, std::int64_t bytes);

  Plan plan_;
  std::int64_t hold_limit_ = std::numeric_limits<std::int64_t>::max();
  int n_buffers_ = kMaxBuffers;
  mutable std::mutex mutex_;
  std::int64_t held_ = 0, buffers_ = 0, peak_ = 0;  // bytes
};

}  // namespace b3dgs
