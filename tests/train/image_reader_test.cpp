#include "train/images/image_reader.h"

#include <gtest/gtest.h>

#include <atomic>
#include <condition_variable>
#include <filesystem>
#include <mutex>
#include <set>

#include "core/check.h"
#include "support/expect_error.h"
#include "support/train/disk_scene.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using Images = std::vector<std::shared_ptr<const ViewImage>>;

constexpr std::size_t kBytes = 3 * 4 * 2;

/// Returns images of 4 x 2 px, where image i is filled with i.
Images numbered_images(int n) {
  Images images;
  for (int i = 0; i < n; ++i) {
    Image8 image(4, 2, 3);
    std::fill(image.pixels.begin(), image.pixels.end(), static_cast<std::uint8_t>(i));
    images.push_back(std::make_shared<ViewImage>(std::move(image)));
  }
  return images;
}

class Buffers {
 public:
  explicit Buffers(int n) : buffers_(static_cast<std::size_t>(n), std::vector<std::uint8_t>(kBytes, 255)) {}
  std::vector<std::uint8_t*> pointers() {
    std::vector<std::uint8_t*> pointers;
    for (auto& buffer : buffers_) pointers.push_back(buffer.data());
    return pointers;
  }

 private:
  std::vector<std::vector<std::uint8_t>> buffers_;
};

TEST(ImageReader, ReadsInAnyOrderWithAnyNumberOfBuffersAndThreads) {
  const Images images = numbered_images(7);
  for (const int n_buffers : {1, 2, 5, 9}) {
    for (const int n_threads : {1, 4}) {
      SCOPED_TRACE(std::to_string(n_buffers) + " buffers, " + std::to_string(n_threads) + " threads");
      Buffers buffers(n_buffers);
      ImageReader reader({images, buffers.pointers(), n_threads, {}});
      const std::vector<std::int32_t> order{3, 0, 0, 6, 1, 2, 5, 4, 3, 3, 2, 6};
      for (std::size_t step = 0; step < order.size(); ++step) {
        reader.expect({order.begin() + static_cast<std::ptrdiff_t>(step), order.end()});
        const std::uint8_t* const rgb = reader.bytes(reader.wait(order[step]));
        for (std::size_t i = 0; i < kBytes; ++i) ASSERT_EQ(rgb[i], order[step]) << "step " << step;
        ASSERT_TRUE(reader.is_ready(order[step]));
      }
    }
  }
}

TEST(ImageReader, DropsImagesThatAreNoLongerExpected) {
  const Images images = numbered_images(6);
  Buffers buffers(2);
  ImageReader reader({images, buffers.pointers(), 2, {}});
  for (int round = 0; round < 200; ++round) {  // threads may be reading images that are no longer expected
    reader.expect({0, 1});
    reader.expect({2, 3});
    reader.expect({4, 5});
    EXPECT_EQ(*reader.bytes(reader.wait(5)), 5);
    EXPECT_EQ(*reader.bytes(reader.wait(4)), 4);
  }
  EXPECT_TRUE(test::fails_with<LogicError>({"image 1 was not expected"}, [&] { reader.wait(1); }));
}

/// Blocks the threads before they write.
class Gate {
 public:
  void pass() {
    std::unique_lock<std::mutex> lock(mutex_);
    ++n_waiting_;
    changed_.notify_all();
    changed_.wait(lock, [&] { return is_open_; });
  }
  void wait_for(int n) {
    std::unique_lock<std::mutex> lock(mutex_);
    changed_.wait(lock, [&] { return n_waiting_ >= n; });
  }
  int n_waiting() {
    const std::lock_guard<std::mutex> lock(mutex_);
    return n_waiting_;
  }
  void open() {
    const std::lock_guard<std::mutex> lock(mutex_);
    is_open_ = true;
    changed_.notify_all();
  }

 private:
  std::mutex mutex_;
  std::condition_variable changed_;
  int n_waiting_ = 0;
  bool is_open_ = false;
};

TEST(ImageReader, ReadsAheadIntoAllBuffersButNotFurther) {
  const Images images = numbered_images(8);
  Buffers buffers(3);
  Gate gate;
  ImageReader reader({images, buffers.pointers(), 8, [&](int) { gate.pass(); }});
  reader.expect({0, 1, 2, 3, 4, 5, 6, 7});
  gate.wait_for(3);  // before the first wait()
  EXPECT_FALSE(reader.is_ready(0));
  gate.open();
  for (const std::int32_t image : {2, 0, 1}) EXPECT_EQ(*reader.bytes(reader.wait(image)), image);
  EXPECT_EQ(gate.n_waiting(), 3);
  EXPECT_FALSE(reader.is_ready(3));
}

TEST(ImageReader, ReadsTheMostUrgentFirst) {
  const Images images = numbered_images(8);
  Buffers buffers(4);
  std::vector<int> written;  // by the only thread
  Gate gate;
  {
    ImageReader reader({images, buffers.pointers(), 1, [&](int buffer) {
                          gate.pass();
                          written.push_back(buffer);
                        }});
    reader.expect({0, 1, 2, 3});
    gate.wait_for(1);          // the thread reads 0
    reader.expect({3, 2, 1});  // 0 keeps its buffer
    gate.open();
    for (const std::int32_t image : {1, 2, 3}) reader.wait(image);
    ASSERT_EQ(written.size(), 4u);
    EXPECT_EQ(written[1], reader.wait(3));
    EXPECT_EQ(written[2], reader.wait(2));
    EXPECT_EQ(written[3], reader.wait(1));
  }
}

TEST(ImageReader, CanBeDestroyedWhileItsThreadsRead) {
  const Images images = numbered_images(40);
  for (int round = 0; round < 50; ++round) {
    Buffers buffers(8);
    ImageReader reader({images, buffers.pointers(), 4, {}});
    std::vector<std::int32_t> all;
    for (std::int32_t i = 0; i < 40; ++i) all.push_back(i);
    reader.expect(all);
  }
}

TEST(ImageReader, ThrowsOnlyForTheImageThatCannotBeRead) {
  const test::DiskScene disk;
  const Scene scene = disk.load();
  Images images;
  for (const View& view : scene.train) images.push_back(view.image);
  fs::remove(disk.image_file(scene.train[1]));
  ImageBuffers memory(images);
  ImageReader reader({images, memory.allocate(), 3, {}});
  reader.expect({0, 1, 2});
  reader.wait(0);
  reader.wait(2);
  EXPECT_FALSE(reader.is_ready(1));
  for (int i = 0; i < 2; ++i) {
    EXPECT_TRUE(test::fails_with<InputError>({disk.image_file(scene.train[1]).string(), "cannot be read"},
                                             [&] { reader.wait(1); }));
  }
  EXPECT_NO_THROW(reader.wait(2));
}

TEST(ReadInOrder, VisitsAllImagesAndReleasesItsBuffers) {
  const test::DiskScene disk;
  for (const double images : {1.0, 2.5, 100.0}) {
    SCOPED_TRACE(std::to_string(images) + " images");
    const Scene scene = disk.load(images);
    ImageMemory& memory = *scene.train.front().image->memory();
    Images all;
    for (const View& view : scene.train) all.push_back(view.image);
    std::size_t next = 0;
    read_in_order(all, 3, [&](std::size_t i, const std::uint8_t* rgb) {
      EXPECT_EQ(i, next++);
      const auto expected = all[i]->read();
      EXPECT_TRUE(std::equal(expected->pixels.begin(), expected->pixels.end(), rgb)) << i;
      EXPECT_GT(memory.used(), 0);
    });
    EXPECT_EQ(next, all.size());
    EXPECT_EQ(memory.used(), 0);
  }
}

}  // namespace
}  // namespace b3dgs
