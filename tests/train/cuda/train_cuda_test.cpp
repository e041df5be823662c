// Tests the parts of training on a GPU that do not use torch.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <numeric>
#include <thread>

#include "core/check.h"
#include "core/gpu_rows.h"
#include "core/random.h"
#include "support/gpu_test.h"
#include "support/same.h"
#include "train/density/density_kernels.h"
#include "train/images/image_uploader.h"
#include "train/images/reduce_image.h"
#include "train/loss/loss.h"
#include "train/loss/loss_args.h"
#include "train/output/device_snapshot.h"

namespace b3dgs {
namespace {

/// A stream that can be blocked.
class GatedStream {
 public:
  GatedStream() { B3DGS_CUDA_CHECK(cudaStreamCreateWithFlags(&stream_, cudaStreamNonBlocking)); }
  ~GatedStream() {
    open();
    cudaStreamDestroy(stream_);
  }
  GatedStream(const GatedStream&) = delete;
  GatedStream& operator=(const GatedStream&) = delete;

  /// Blocks work queued from now on until open().
  void close() {
    is_open_ = false;
    const auto wait = [](void* gate) {
      while (!static_cast<std::atomic<bool>*>(gate)->load()) std::this_thread::yield();
    };
    B3DGS_CUDA_CHECK(cudaLaunchHostFunc(stream_, wait, &is_open_));
  }
  /// Unblocks the stream, and waits until all queued work is done.
  void open() {
    is_open_ = true;
    cudaStreamSynchronize(stream_);
  }
  cudaStream_t get() const { return stream_; }

 private:
  cudaStream_t stream_ = nullptr;
  std::atomic<bool> is_open_{true};
};

/// Returns bytes that identify image `seed`.
std::vector<std::uint8_t> image(int seed, std::size_t n) {
  std::vector<std::uint8_t> bytes(n);
  for (std::size_t i = 0; i < n; ++i) bytes[i] = static_cast<std::uint8_t>(37 * seed + 3 * i + i / 251);
  return bytes;
}

TEST(DeviceSnapshot, KeepsTheOldValuesWhileTheArraysChange) {
  B3DGS_NEEDS_GPU();
  const std::size_t sizes[] = {3 * cuda::DeviceReader::kPieceBytes + 1234, 1000};
  const std::vector<std::uint8_t> images[] = {image(1, sizes[0]), image(2, sizes[1])};
  const test::DeviceArray<std::uint8_t> large(images[0].data(), static_cast<std::int64_t>(sizes[0]));
  const test::DeviceArray<std::uint8_t> small(images[1].data(), static_cast<std::int64_t>(sizes[1]));
  GatedStream stream;
  cuda::DeviceReader reader;
  B3DGS_CUDA_CHECK(cudaDeviceSynchronize());  // the arrays have been filled
  const auto bytes_of = [](const test::DeviceArray<std::uint8_t>& array, std::size_t n) {
    return std::string_view(reinterpret_cast<const char*>(array.data()), n);
  };
  const auto snapshot =
      cuda::make_device_snapshot({bytes_of(large, sizes[0]), {}, bytes_of(small, sizes[1])}, stream.get());
  ASSERT_NE(snapshot, nullptr);
  reader.follow(stream.get());
  B3DGS_CUDA_CHECK(cudaMemsetAsync(large.data(), 0, sizes[0], stream.get()));
  ASSERT_EQ(snapshot->arrays.size(), 3u);
  for (const std::size_t i : {std::size_t{0}, std::size_t{2}}) {
    std::vector<std::uint8_t> read;
    const std::string_view copy = snapshot->arrays[i];
    reader.read(copy.data(), copy.size(), [&](const void* piece, std::size_t bytes) {
      const auto* const from = static_cast<const std::uint8_t*>(piece);
      read.insert(read.end(), from, from + bytes);
    });
    EXPECT_TRUE(test::same(read, images[i / 2])) << i;
  }
  EXPECT_EQ(cuda::make_device_snapshot({bytes_of(large, std::size_t{1} << 50)}, stream.get()), nullptr) << "no room";
}

class ImageUploaderTest : public testing::Test {
 protected:
  static constexpr std::size_t kBytes = 1 << 20;
  /// Copies the content of a slot to `out`, after all work queued on the stream.
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
  cuda::ImageUploader uploader(1, 2, kBytes);
  std::copy(first.begin(), first.end(), uploader.staging()[0]);
  std::copy(second.begin(), second.end(), uploader.staging()[1]);
  const test::DeviceArray<std::uint8_t> seen_first(kBytes), seen_second(kBytes);
  GatedStream slow, other;
  B3DGS_CUDA_CHECK(cudaDeviceSynchronize());  // the arrays have been filled
  uploader.upload(0, kBytes, 0);
  const std::uint8_t* const slot = uploader.acquire(0, slow.get());
  slow.close();
  read(slot, seen_first, slow.get());
  uploader.release(0, slow.get());
  uploader.upload(1, kBytes, 0);  // must wait for the slow reader
  read(uploader.acquire(0, other.get()), seen_second, other.get());
  EXPECT_EQ(cudaStreamQuery(other.get()), cudaErrorNotReady) << "overwritten while the first reader needs it";
  slow.open();
  other.open();
  EXPECT_TRUE(test::same(host_copy(seen_first), first));
  EXPECT_TRUE(test::same(host_copy(seen_second), second));
}

TEST_F(ImageUploaderTest, BringsManyImagesThroughAFewSlots) {
  B3DGS_NEEDS_GPU();
  constexpr int kImages = 7, kSlots = 3;
  cuda::ImageUploader uploader(kSlots, kImages, kBytes);
  std::vector<std::vector<std::uint8_t>> images;
  for (int i = 0; i < kImages; ++i) {
    images.push_back(image(i, kBytes));
    std::copy(images.back().begin(), images.back().end(), uploader.staging()[static_cast<std::size_t>(i)]);
  }
  constexpr int kSteps = 20;
  GatedStream reader;
  std::vector<test::DeviceArray<std::uint8_t>> seen;
  for (int step = 0; step < kSteps; ++step) seen.emplace_back(static_cast<std::int64_t>(kBytes));
  B3DGS_CUDA_CHECK(cudaDeviceSynchronize());  // the arrays have been filled
  for (int step = 0; step < kSteps; ++step) {
    const int slot = step % kSlots;
    uploader.upload(step % kImages, kBytes, slot);
    read(uploader.acquire(slot, reader.get()), seen[static_cast<std::size_t>(step)], reader.get());
    uploader.release(slot, reader.get());
  }
  reader.open();
  for (int step = 0; step < kSteps; ++step) {
    EXPECT_TRUE(
        test::same(host_copy(seen[static_cast<std::size_t>(step)]), images[static_cast<std::size_t>(step % kImages)]))
        << "step " << step;
  }
}

TEST_F(ImageUploaderTest, RejectsImagesLargerThanASlot) {
  B3DGS_NEEDS_GPU();
  cuda::ImageUploader uploader(1, 1, 10);
  EXPECT_THROW(uploader.upload(0, 11, 0), LogicError);
}

TEST(SplitSamples, EqualThoseOfTheCpuUpToRounding) {
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
  SplitSampleArgs args;
  args.rows = rows.data();
  args.gaussians.means = means.data();
  args.gaussians.log_scales = log_scales.data();
  args.gaussians.quats = quats.data();
  args.key = {/*seed=*/5, RandomStream::kSplit, /*iteration=*/700};
  args.sample = 1;
  args.out = expected.data();
  for (std::int64_t i = 0; i < kRows; ++i) draw_split_sample(args, i);

  const test::DeviceArray<std::int64_t> device_rows(rows.data(), kRows);
  const test::DeviceArray<float> device_means(means.data(), 3 * kGaussians);
  const test::DeviceArray<float> device_log_scales(log_scales.data(), 3 * kGaussians);
  const test::DeviceArray<float> device_quats(quats.data(), 4 * kGaussians), device_out(3 * kRows);
  args.rows = device_rows.data();
  args.gaussians.means = device_means.data();
  args.gaussians.log_scales = device_log_scales.data();
  args.gaussians.quats = device_quats.data();
  args.out = device_out.data();
  cuda::for_rows<draw_split_sample>(args, kRows, nullptr);
  device_out.download(found.data());
  for (std::size_t i = 0; i < found.size(); ++i) {
    EXPECT_NEAR(found[i], expected[i], 1e-6 * std::max(1.0f, std::fabs(expected[i]))) << i;
  }
}

TEST(ReduceImageOnGpu, EqualsThatOfTheCpu) {
  B3DGS_NEEDS_GPU();
  for (const auto& [width, height, scale] :
       std::vector<std::array<int, 3>>{{64, 48, 2}, {1001, 333, 3}, {130, 70, 8}, {1, 1, 1}, {3, 2, 4}}) {
    const auto n = static_cast<std::size_t>(width) * height;
    std::vector<std::uint8_t> rgb(3 * n), valid(n);
    const RandomKey key{29, RandomStream::kBackground, 0};
    for (std::size_t p = 0; p < n; ++p) {
      const auto random = random_uniform(key, p);
      for (std::size_t c = 0; c < 3; ++c) rgb[3 * p + c] = static_cast<std::uint8_t>(256 * random[c]);
      valid[p] = random[3] < 0.4f ? 0 : 255;
    }
    const test::DeviceArray<std::uint8_t> device_rgb(rgb.data(), 3 * n), device_valid(valid.data(), n);
    for (const bool is_masked : {false, true}) {
      ReduceImageArgs args;
      args.width = width;
      args.height = height;
      args.scale = scale;
      const auto n_reduced = static_cast<std::size_t>(args.reduced_width()) * args.reduced_height();
      std::vector<std::uint8_t> expected(3 * n_reduced), mask(n_reduced);
      args.rgb = rgb.data();
      args.valid = is_masked ? valid.data() : nullptr;
      args.reduced = expected.data();
      args.reduced_valid = is_masked ? mask.data() : nullptr;
      for (std::int64_t i = 0; i < args.n_reduced(); ++i) reduce_pixel(args, i);
      const test::DeviceArray<std::uint8_t> device_reduced(3 * n_reduced + 1), device_mask(n_reduced + 1);
      args.rgb = device_rgb.data();
      args.valid = is_masked ? device_valid.data() : nullptr;
      args.reduced = device_reduced.data();
      args.reduced_valid = is_masked ? device_mask.data() : nullptr;
      cuda::for_rows<reduce_pixel>(args, args.n_reduced(), nullptr);
      if (n_reduced == 0) continue;  // nothing is written, without an error
      std::vector<std::uint8_t> downloaded(3 * n_reduced + 1);
      device_reduced.download(downloaded.data());
      EXPECT_TRUE(std::equal(expected.begin(), expected.end(), downloaded.begin())) << width << " / " << scale;
      if (!is_masked) continue;
      device_mask.download(downloaded.data());
      EXPECT_TRUE(std::equal(mask.begin(), mask.end(), downloaded.begin())) << width << " / " << scale;
    }
  }
}

struct LossCase {
  std::int32_t width, height;  // px
  int invalid_of_16;           // number of invalid pixels among 16; 0 = no mask
};

class LossOnGpu : public testing::TestWithParam<LossCase> {};

TEST_P(LossOnGpu, EqualsThatOfTheCpu) {
  B3DGS_NEEDS_GPU();
  const LossCase& image = GetParam();
  const std::int64_t n_pixels = std::int64_t{image.width} * image.height;
  const auto n_values = static_cast<std::size_t>(3 * n_pixels);
  std::vector<float> rendered(n_values), expected(n_values), found(n_values);
  std::vector<std::uint8_t> truth(n_values), valid(static_cast<std::size_t>(n_pixels));
  const RandomKey key{23, RandomStream::kBackground, 0};
  for (std::size_t i = 0; i < n_values; ++i) {
    const auto random = random_uniform(key, i);
    truth[i] = static_cast<std::uint8_t>(255 * random[0]);
    rendered[i] = 1.5f * random[1] - 0.2f;  // also outside [0, 1]
  }
  for (std::size_t i = 0; i < valid.size(); ++i) valid[i] = static_cast<int>(7 * i % 16) >= image.invalid_of_16 ? 1 : 0;

  LossArgs args{image.width, image.height, rendered.data(), truth.data()};
  if (image.invalid_of_16 > 0) args.valid = valid.data();
  args.n_valid = image.invalid_of_16 > 0 ? count_valid(valid.data(), n_pixels) : n_pixels;
  args.weights.dssim = 0.2;
  args.grad = expected.data();
  struct alignas(64) Aligned {
    float of[16];
  };
  std::vector<Aligned> workspace(static_cast<std::size_t>(cpu::loss_workspace_size(image.width, image.height)) / 16 +
                                 1);
  args.workspace = workspace.front().of;
  const LossValue wanted = cpu::compute_loss(args);

  const test::DeviceArray<float> device_rendered(rendered.data(), 3 * n_pixels), device_grad(3 * n_pixels);
  const test::DeviceArray<std::uint8_t> device_truth(truth.data(), 3 * n_pixels), device_valid(valid.data(), n_pixels);
  const test::DeviceArray<float> device_workspace(cuda::loss_workspace_size(image.width, image.height));
  const test::DeviceArray<LossValue> device_value(1);
  args.rendered = device_rendered.data();
  args.truth = device_truth.data();
  if (args.valid != nullptr) args.valid = device_valid.data();
  args.workspace = device_workspace.data();
  args.grad = device_grad.data();
  cuda::compute_loss(args, device_value.data(), nullptr);
  LossValue value;
  device_value.download(&value);
  EXPECT_NEAR(value.loss, wanted.loss, 1e-6);
  EXPECT_NEAR(value.l1, wanted.l1, 1e-6);
  EXPECT_NEAR(value.ssim, wanted.ssim, 1e-6);
  device_grad.download(found.data());
  double largest = 0, apart = 0;
  for (std::size_t i = 0; i < n_values; ++i) {
    largest = std::max(largest, std::fabs(static_cast<double>(expected[i])));
    apart = std::max(apart, std::fabs(static_cast<double>(found[i]) - static_cast<double>(expected[i])));
  }
  EXPECT_EQ(largest > 0, args.n_valid > 0);
  EXPECT_LE(apart, 2e-5 * largest);
}

// Images smaller than the window, smaller than a block, slightly larger or smaller than a block, and of several blocks.
INSTANTIATE_TEST_SUITE_P(BySize, LossOnGpu,
                         testing::Values(LossCase{1, 1, 0}, LossCase{5, 3, 0}, LossCase{32, 32, 0}, LossCase{31, 33, 5},
                                         LossCase{97, 70, 0}, LossCase{97, 70, 1}, LossCase{64, 41, 12},
                                         LossCase{33, 20, 16}),
                         [](const auto& info) {
                           return std::to_string(info.param.width) + "x" + std::to_string(info.param.height) +
                                  "Invalid" + std::to_string(info.param.invalid_of_16);
                         });

}  // namespace
}  // namespace b3dgs
