// What the decoded photographs of a scene may take of host memory: a limit, divided between photographs that stay and
// the buffers of those that read ahead; and a count of what is in use.
#pragma once

#include <algorithm>
#include <cstdint>
#include <limits>
#include <mutex>

namespace b3dgs {

/// Bytes for --host_memory_gb; for -1, 80 % of `available_bytes`.
std::int64_t image_memory_limit(double host_memory_gb, std::int64_t available_bytes);

/// Threads may share it.
class ImageMemory {
 public:
  static constexpr int kMaxBuffers = 64;  // of one reader: beyond a second of steps nothing is gained

  struct Plan {
    std::int64_t limit = std::numeric_limits<std::int64_t>::max();
    std::int64_t photographs = 0, largest = 0;  // bytes: of all, of the largest
    std::int64_t fixed = 0;                     // bytes in use whatever the limit: masks, maps that undo distortion
    int n_readers = 1;                          // that read ahead at the same time
  };

  /// Without a limit.
  ImageMemory() = default;
  /// If not all photographs fit, readers get up to a quarter of the memory; a buffer each, if that is more.
  explicit ImageMemory(const Plan& plan);

  std::int64_t limit() const { return plan_.limit; }
  std::int64_t fixed() const { return plan_.fixed; }
  /// Buffers for one reader, 1 to kMaxBuffers.
  int n_buffers() const { return n_buffers_; }

  /// Counts a photograph that stays if there is room for it.
  bool try_hold(std::int64_t bytes);
  /// Undoes that.
  void release_held(std::int64_t bytes);
  /// Counts buffers; a reader takes no more than n_buffers() of the largest photograph.
  void take_buffers(std::int64_t bytes);
  void give_buffers_back(std::int64_t bytes);

  std::int64_t used() const;  // bytes, Plan::fixed included
  std::int64_t peak() const;  // the most that was ever used

 private:
  void note_peak() { peak_ = std::max(peak_, held_ + buffers_); }

  Plan plan_;
  std::int64_t hold_limit_ = std::numeric_limits<std::int64_t>::max();
  int n_buffers_ = kMaxBuffers;
  mutable std::mutex mutex_;
  std::int64_t held_ = 0, buffers_ = 0, peak_ = 0;  // bytes; held_ includes Plan::fixed
};

/// Buffers that are counted for as long as this lives.
class ImageBufferCount {
 public:
  ImageBufferCount(ImageMemory& memory, std::int64_t bytes) : memory_(memory), bytes_(bytes) {
    memory_.take_buffers(bytes_);
  }
  ~ImageBufferCount() { memory_.give_buffers_back(bytes_); }
  ImageBufferCount(const ImageBufferCount&) = delete;
  ImageBufferCount& operator=(const ImageBufferCount&) = delete;

 private:
  ImageMemory& memory_;
  const std::int64_t bytes_;
};

}  // namespace b3dgs
