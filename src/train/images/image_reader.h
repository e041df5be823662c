// Background threads that read photographs ahead, in the order of use, into a fixed number of buffers.
#pragma once

#include <algorithm>
#include <condition_variable>
#include <cstdint>
#include <exception>
#include <functional>
#include <memory>
#include <mutex>
#include <thread>
#include <vector>

#include "core/check.h"
#include "scene/view_image.h"

namespace b3dgs {

/// Keeps track of which photograph is in which of a few slots in GPU or host memory. It moves no data itself.
class UploadSlots {
 public:
  static constexpr std::int32_t kEmpty = -1;
  struct Upload {
    int slot;
    std::int32_t view;
  };

  explicit UploadSlots(int n_slots) : views_(static_cast<std::size_t>(n_slots), kEmpty) {}

  std::int32_t view_in(int slot) const { return views_[static_cast<std::size_t>(slot)]; }

  /// Returns the slot of a view, or -1 if it has none.
  int slot_of(std::int32_t view) const {
    const auto it = std::find(views_.begin(), views_.end(), view);
    return it == views_.end() ? -1 : static_cast<int>(it - views_.begin());
  }

  /// Assigns a slot to each of `wanted` (at most as many as there are slots). Wanted views that already have a slot
  /// keep it. Returns the necessary uploads, in the order of `wanted`.
  std::vector<Upload> assign(const std::vector<std::int32_t>& wanted) {
    B3DGS_CHECK(wanted.size() <= views_.size(), wanted.size(), " views for ", views_.size(), " slots");
    std::vector<Upload> uploads;
    for (const std::int32_t view : wanted) {
      if (slot_of(view) >= 0) continue;
      const auto slot = std::find_if(views_.begin(), views_.end(), [&](std::int32_t other) {
        return std::find(wanted.begin(), wanted.end(), other) == wanted.end();
      });
      *slot = view;
      uploads.push_back({static_cast<int>(slot - views_.begin()), view});
    }
    return uploads;
  }

 private:
  std::vector<std::int32_t> views_;  // by slot
};

/// Other work of the program while photographs are read.
enum class ReadingLoad { kNothing, kGpuTraining, kCpuTraining };

/// Returns the number of reading threads to use beside this work.
int reading_threads(ReadingLoad load);

/// Reads images ahead in its own threads, which end with it. May be used by one thread at a time.
class ImageReader {
 public:
  struct Setup {
    std::vector<std::shared_ptr<const ViewImage>> images;
    std::vector<std::uint8_t*> buffers;  // at least one, each large enough for any image; must outlive the reader
    int n_threads = 1;
    std::function<void(int buffer)> before_write;  // called by a reading thread before it writes; may be empty
  };

  explicit ImageReader(Setup setup);
  ~ImageReader();
  ImageReader(const ImageReader&) = delete;
  ImageReader& operator=(const ImageReader&) = delete;

  int n_buffers() const { return static_cast<int>(setup_.buffers.size()); }

  /// Announces the images that wait() will be called for, in this order. As many of them as there are buffers are read.
  /// Buffers of other images may be overwritten from now on. Asynchronous.
  void expect(const std::vector<std::int32_t>& images);

  /// Returns whether wait() would return immediately and without an error.
  bool is_ready(std::int32_t image) const;

  /// Waits until the image is read and returns the index of its buffer. The image must already be ready, or be among
  /// those that the last expect() assigned a buffer to. @throws the exception that was thrown when it was read
  int wait(std::int32_t image) const;

  const std::uint8_t* bytes(int buffer) const { return setup_.buffers[static_cast<std::size_t>(buffer)]; }

 private:
  struct Buffer {
    std::int32_t content = UploadSlots::kEmpty;  // image in the buffer
    bool is_written = false;                     // a thread is writing to it
    std::exception_ptr error;                    // exception from reading `content`
  };

  void stop();
  void run_thread();
  bool has_to_be_read(int buffer) const;
  /// Returns the buffer of an image that has been read, or null.
  const Buffer* find_read(std::int32_t image) const;

  const Setup setup_;
  UploadSlots slots_;  // which image each buffer is for
  mutable std::mutex mutex_;
  mutable std::condition_variable work_, done_;
  std::vector<Buffer> buffers_;  // this and the next two are guarded by mutex_
  std::vector<int> order_;       // buffers, the most urgent first
  bool is_stopping_ = false;
  std::vector<std::thread> threads_;
};

/// Buffers for a reader: as many as the scene's ImageMemory allows, at most one per image, and each large enough for
/// any of the images. Their memory stays reserved there while this object exists.
class ImageBuffers {
 public:
  explicit ImageBuffers(const std::vector<std::shared_ptr<const ViewImage>>& images);
  int count() const { return count_; }
  std::int64_t n_bytes() const { return n_bytes_; }  // per buffer
  /// Allocates the buffers in pageable host memory.
  std::vector<std::uint8_t*> allocate();

 private:
  int count_ = 0;
  std::int64_t n_bytes_ = 0;
  ImageMemory::Use in_use_;
  std::unique_ptr<std::uint8_t[]> memory_;
};

/// Calls body(index, RGB bytes) for each image in order, on this thread, while other threads read ahead. Images in
/// memory are not copied. The bytes are valid during the call. @throws InputError for an image that cannot be read
void read_in_order(const std::vector<std::shared_ptr<const ViewImage>>& images, int n_threads,
                   const std::function<void(std::size_t index, const std::uint8_t* rgb)>& body);

}  // namespace b3dgs
