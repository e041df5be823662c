// Photographs in the order in which they are wanted, read ahead by threads into a fixed number of buffers.
#pragma once

#include <condition_variable>
#include <cstdint>
#include <exception>
#include <functional>
#include <memory>
#include <mutex>
#include <thread>
#include <vector>

#include "scene/view_image.h"
#include "train/images/upload_slots.h"

namespace b3dgs {

/// Threads that read ahead, beside a training that keeps the CPU busy or one that leaves it to them.
int reading_threads(bool cpu_is_busy);

/// Used by one thread. Its own threads end with it.
class ImageReader {
 public:
  struct Setup {
    std::vector<std::shared_ptr<const ViewImage>> images;
    std::vector<std::uint8_t*> buffers;  // at least one, each for the largest image; they must outlive the reader
    int n_threads = 1;
    std::function<void(int buffer)> before_write;  // called by a thread before it writes to a buffer; may be empty
  };

  explicit ImageReader(Setup setup);
  ~ImageReader();
  ImageReader(const ImageReader&) = delete;
  ImageReader& operator=(const ImageReader&) = delete;

  int n_buffers() const { return static_cast<int>(setup_.buffers.size()); }

  /// The images that will be waited for, the next one first; as many of them as there are buffers are read. Buffers of
  /// others may be overwritten from now on. Does not wait.
  void expect(const std::vector<std::int32_t>& images);

  /// Whether wait() would return at once.
  bool is_ready(std::int32_t image) const;

  /// Number of the buffer that holds the image: one for which is_ready(), or which the last expect() has found a buffer
  /// for. Waits until it is read. @throws what reading it has thrown
  int wait(std::int32_t image) const;

  const std::uint8_t* bytes(int buffer) const { return setup_.buffers[static_cast<std::size_t>(buffer)]; }

 private:
  static constexpr std::int32_t kNone = -1;
  struct Buffer {
    std::int32_t wanted = kNone, content = kNone;  // images; equal once it is read
    bool is_written = false;                       // by a thread, now
    std::exception_ptr error;                      // of reading `content`
  };

  void stop();
  void run_thread();
  int next_to_read() const;
  bool is_read(std::int32_t image) const;

  const Setup setup_;
  UploadSlots slots_;  // which image belongs into which buffer
  mutable std::mutex mutex_;
  mutable std::condition_variable work_, done_;
  std::vector<Buffer> buffers_;  // this and the next two under the mutex
  std::vector<int> order_;       // of buffers, the most urgent first
  bool is_stopping_ = false;
  std::vector<std::thread> threads_;
};

/// How many buffers a reader of some images gets.
struct BufferPlan {
  /// As many as the memory of the images allows, but no more than `images`; each for the largest of them.
  explicit BufferPlan(const std::vector<std::shared_ptr<const ViewImage>>& images);

  int count = 0;
  std::int64_t n_bytes = 0;                  // of each
  std::unique_ptr<ImageBufferCount> in_use;  // counted by the memory of the scene as long as this lives
};

/// Buffers in ordinary memory.
class ImageBuffers {
 public:
  explicit ImageBuffers(const std::vector<std::shared_ptr<const ViewImage>>& images);
  std::vector<std::uint8_t*> pointers() const;

 private:
  BufferPlan plan_;
  std::vector<std::unique_ptr<std::uint8_t[]>> buffers_;
};

/// Calls body(index, RGB bytes) for the images in their order, on this thread, while others read ahead. Those in memory
/// are not copied; the bytes are valid during the call. @throws InputError for an image that cannot be read
void read_in_order(const std::vector<std::shared_ptr<const ViewImage>>& images, int n_threads,
                   const std::function<void(std::size_t index, const std::uint8_t* rgb)>& body);

}  // namespace b3dgs
