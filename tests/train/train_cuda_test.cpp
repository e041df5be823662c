// The parts of training on a GPU that know no torch.
#include <gtest/gtest.h>

#include <array>
#include <atomic>
#include <numeric>
#include <thread>

#include "check.h"
#include "support/gpu_test.h"
#include "train/cuda/event_marks.h"
#include "train/cuda/image_uploader.h"
#include "train/cuda/split_samples_cuda.h"

namespace b3dgs {
namespace {

/// A stream of its own that can be held up.
class GatedStream {
 public:
  GatedStream() { B3DGS_CUDA_CHECK(cudaStreamCreateWithFlags(&stream_, cudaStreamNonBlocking)); }
  ~GatedStream() {
    open();
    cudaStreamDestroy(stream_);
  }
  GatedStream(const GatedStream&) = delete;
  GatedStream& operator=(const GatedStream&) = delete;

  /// What is queued from now on is not begun before open().
  void close() {
    is_open_ = false;
    const auto wait = [](void* gate) {
      while (!static_cast<std::atomic<bool>*>(gate)->load()) std::this_thread::yield();
    };
    B3DGS_CUDA_CHECK(cudaLaunchHostFunc(stream_, wait, &is_open_));
  }
  /// Returns when all is done that was queued.
  void open() {
    is_open_ = true;
    cudaStreamSynchronize(stream_);
  }
  cudaStream_t get() const { return stream_; }

 private:
  cudaStream_t stream_ = nullptr;
  std::atomic<bool> is_open_{true};
};

TEST(EventMarks, AreReachedWhenTheDeviceGetsThere) {
  B3DGS_NEEDS_GPU();
  GatedStream stream;
  cuda::EventMarks marks;
  const int before = marks.record(stream.get());
  stream.close();
  const int behind = marks.record(stream.get());
  EXPECT_NE(before, behind);
  EXPECT_FALSE(marks.has_reached(behind));
  stream.open();
  marks.wait(behind);
  EXPECT_TRUE(marks.has_reached(before));
  EXPECT_TRUE(marks.has_reached(behind));
  EXPECT_GT(marks.ms_between(before, behind), 0);
  marks.release(before);
  EXPECT_EQ(marks.record(stream.get()), before) << "used again";
}

/// Bytes that tell image `seed` from others.
std::vector<std::uint8_t> image(int seed, std::size_t n) {
  std::vector<std::uint8_t> bytes(n);
  for (std::size_t i = 0; i < n; ++i) bytes[i] = static_cast<std::uint8_t>(37 * seed + 3 * i + i / 251);
  return bytes;
}

class ImageUploaderTest : public testing::Test {
 protected:
  static constexpr std::size_t kBytes = 1 << 20;
  /// What a reader on the stream finds in a slot: copied behind all that is queued there.
  static void read(const std::uint8_t* slot, const test::DeviceArray<std::uint8_t>& out, cudaStream_t stream) {
    B3DGS_CUDA_CHECK(cudaMemcpyAsync(out.data(), slot, kBytes, cudaMemcpyDeviceToDevice, stream));
  }
  static std::vector<std::uint8_t> host_copy(const test::DeviceArray<std::uint8_t>& array) {
    std::vector<std::uint8_t> bytes(kBytes);
    array.download(bytes.data());
    return bytes;
  }
};

TEST_F(ImageUploaderTest, NeverWritesASlotThatIsStillRead) {
  B3DGS_NEEDS_GPU();
  const std::vector<std::uint8_t> first = image(1, kBytes), second = image(2, kBytes);
  cuda::ImageUploader uploader(1, kBytes);
  const int a = uploader.add({&first}), b = uploader.add({&second});
  const test::DeviceArray<std::uint8_t> seen_first(kBytes), seen_second(kBytes);
  GatedStream slow, other;
  B3DGS_CUDA_CHECK(cudaDeviceSynchronize());  // the arrays have been filled
  uploader.upload(a, 0);
  const std::uint8_t* const slot = uploader.acquire(0, slow.get());
  slow.close();
  read(slot, seen_first, slow.get());
  uploader.release(0, slow.get());
  uploader.upload(b, 0);  // has to wait for the slow reader
  read(uploader.acquire(0, other.get()), seen_second, other.get());
  EXPECT_EQ(cudaStreamQuery(other.get()), cudaErrorNotReady) << "uploaded over what the first reader still needs";
  slow.open();
  other.open();
  EXPECT_TRUE(host_copy(seen_first) == first);
  EXPECT_TRUE(host_copy(seen_second) == second);
}

TEST_F(ImageUploaderTest, BringsManyImagesThroughAFewSlots) {
  B3DGS_NEEDS_GPU();
  constexpr int kImages = 7, kSlots = 3;
  cuda::ImageUploader uploader(kSlots, kBytes);
  std::vector<std::vector<std::uint8_t>> images;
  for (int i = 0; i < kImages; ++i) {
    const std::vector<std::uint8_t> whole = image(i, kBytes);
    const std::vector<std::uint8_t> front(whole.begin(), whole.begin() + 1000), back(whole.begin() + 1000, whole.end());
    EXPECT_EQ(uploader.add({&front, &back}), i);
    images.push_back(whole);
  }
  constexpr int kSteps = 20;
  GatedStream reader;
  std::vector<test::DeviceArray<std::uint8_t>> seen;
  for (int step = 0; step < kSteps; ++step) seen.emplace_back(static_cast<std::int64_t>(kBytes));
  B3DGS_CUDA_CHECK(cudaDeviceSynchronize());  // the arrays have been filled
  for (int step = 0; step < kSteps; ++step) {
    const int slot = step % kSlots;
    uploader.upload(step % kImages, slot);
    read(uploader.acquire(slot, reader.get()), seen[static_cast<std::size_t>(step)], reader.get());
    uploader.release(slot, reader.get());
  }
  reader.open();
  for (int step = 0; step < kSteps; ++step) {
    EXPECT_TRUE(host_copy(seen[static_cast<std::size_t>(step)]) == images[static_cast<std::size_t>(step % kImages)])
        << "step " << step;
  }
}

TEST_F(ImageUploaderTest, RefusesImagesLargerThanASlot) {
  B3DGS_NEEDS_GPU();
  cuda::ImageUploader uploader(1, 10);
  const std::vector<std::uint8_t> bytes(11);
  EXPECT_THROW(uploader.add({&bytes}), LogicError);
}

TEST(SplitSamples, AreThoseOfTheCpuUpToRounding) {
  B3DGS_NEEDS_GPU();
  constexpr std::int64_t kGaussians = 3000, kRows = 1000;
  std::vector<float> means(3 * kGaussians), log_scales(3 * kGaussians), quats(4 * kGaussians);
  for (std::int64_t i = 0; i < kGaussians; ++i) {
    const auto row = static_cast<std::uint64_t>(3 * i);
    const RandomKey key{17, RandomStream::kBackground, 0};
    const auto a = random_normal(key, row), b = random_normal(key, row + 1), c = random_normal(key, row + 2);
    for (std::size_t axis = 0; axis < 3; ++axis) {
      means[static_cast<std::size_t>(3 * i) + axis] = 10 * a[axis];
      log_scales[static_cast<std::size_t>(3 * i) + axis] = 2 * b[axis] - 2;
    }
    for (std::size_t axis = 0; axis < 4; ++axis) quats[static_cast<std::size_t>(4 * i) + axis] = c[axis];
  }
  std::vector<std::int64_t> rows(kRows);
  for (std::int64_t i = 0; i < kRows; ++i) rows[static_cast<std::size_t>(i)] = 2999 - 2 * i;
  std::vector<float> expected(3 * kRows), found(3 * kRows);
  SplitSampleArgs args{kRows,        rows.data(),
                       means.data(), log_scales.data(),
                       quats.data(), {/*seed=*/5, RandomStream::kSplit, /*iteration=*/700},
                       /*sample=*/1, expected.data()};
  for (std::int64_t i = 0; i < kRows; ++i) draw_split_sample(args, i);

  const test::DeviceArray<std::int64_t> device_rows(rows.data(), kRows);
  const test::DeviceArray<float> device_means(means.data(), 3 * kGaussians);
  const test::DeviceArray<float> device_log_scales(log_scales.data(), 3 * kGaussians);
  const test::DeviceArray<float> device_quats(quats.data(), 4 * kGaussians), device_out(3 * kRows);
  args.rows = device_rows.data();
  args.means = device_means.data();
  args.log_scales = device_log_scales.data();
  args.quats = device_quats.data();
  args.out = device_out.data();
  cuda::draw_split_samples(args, nullptr);
  device_out.download(found.data());
  for (std::size_t i = 0; i < found.size(); ++i) {
    EXPECT_NEAR(found[i], expected[i], 1e-6 * std::max(1.0f, std::fabs(expected[i]))) << i;
  }
}

}  // namespace
}  // namespace b3dgs
