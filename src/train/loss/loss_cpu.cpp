// The loss on the CPU, in bands of rows.
//
// The taps of the separable SSIM window are 3 floats apart in an interleaved RGB row. Pass 1 goes down a band. It
// filters each row horizontally into a ring of 11 rows, and sums these vertically. This gives the SSIM of each pixel
// and its derivatives with respect to the three window means that depend on the rendered image, which are filtered
// horizontally and stored. Pass 2 filters them vertically, which gives the gradient, because the window is symmetric.
// Bands overlap by 10 rows in pass 1 and share nothing else.

#include "train/loss/loss.h"

#include <algorithm>
#include <array>
#include <cstring>
#include <vector>

#include "core/check.h"
#include "core/parallel.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "train/loss/loss_cpu.cpp"
#include <hwy/foreach_target.h>
// Highway requires this after foreach_target.h.
#include <hwy/aligned_allocator.h>
#include <hwy/highway.h>

#ifndef B3DGS_TRAIN_LOSS_CPU_ONCE
#define B3DGS_TRAIN_LOSS_CPU_ONCE
namespace b3dgs::cpu {

constexpr int kRadius = kSsimRadius;
constexpr int kTaps = 2 * kRadius + 1;
constexpr std::int64_t kBandRows = 32;
constexpr std::int64_t kMaxLanes = 16;
constexpr std::int64_t kPadding = 16;  // floats before and after a row: 3 * kRadius, rounded up to whole vectors

/// Layout of an image row, with zero padding before and after it so that vector loads and stores may overrun the row.
struct RowLayout {
  explicit RowLayout(std::int64_t width) : n(3 * width), rounded((n + kMaxLanes - 1) / kMaxLanes * kMaxLanes) {}
  std::int64_t n;        // floats in a row
  std::int64_t rounded;  // n rounded up to whole vectors
  std::int64_t stride() const { return rounded + 2 * kPadding; }
};

/// Sums of one row.
struct RowSums {
  double l1 = 0, ssim = 0;
};

}  // namespace b3dgs::cpu
#endif  // B3DGS_TRAIN_LOSS_CPU_ONCE

HWY_BEFORE_NAMESPACE();
namespace b3dgs::cpu::HWY_NAMESPACE {

namespace {

namespace hn = hwy::HWY_NAMESPACE;
using FloatTag = hn::CappedTag<float, kMaxLanes>;
using FloatVec = hn::Vec<FloatTag>;

/// Computes the bands of one thread.
class BandLoss {
 public:
  explicit BandLoss(const LossArgs& args)
      : args_(args),
        layout_(args.width),
        scratch_(hwy::AllocateAligned<float>(static_cast<std::size_t>(kScratchRows * layout_.stride()))) {
    std::fill_n(scratch_.get(), kScratchRows * layout_.stride(), 0.0f);
    std::fill_n(weight(), layout_.n, 1.0f);
  }

  /// Writes SSIM and L1 of rows [begin, end) to sums[row]. If a gradient is wanted, also writes derivatives to the
  /// workspace.
  void value(std::int64_t begin, std::int64_t end, RowSums* sums) {
    for (std::int64_t row = begin - kRadius; row < end + kRadius; ++row) {
      if (row >= 0 && row < args_.height) {
        load_row(row);
        const double l1 = multiply_row();
        if (row >= begin && row < end) sums[row].l1 = l1;
        filter_row(x(), ring(0, row));
        filter_row(y(), ring(1, row));
        filter_row(squares(), ring(2, row));
        filter_row(product(), ring(3, row));
      }
      const std::int64_t center = row - kRadius;
      if (center >= begin) sums[center].ssim = ssim_row(center);
    }
  }

  /// Computes the gradient of rows [begin, end) from the derivatives of all rows.
  void gradient(std::int64_t begin, std::int64_t end) {
    const FloatTag d;
    const LossScales scales = loss_scales(args_);
    const auto l1_scale = hn::Set(d, scales.l1), ssim_scale = hn::Set(d, scales.ssim);
    const auto zero = hn::Zero(d);
    for (std::int64_t row = begin; row < end; ++row) {
      load_row(row);
      std::array<WindowRows, 3> rows;
      for (int which = 0; which < 3; ++which) {
        rows[which] = window_rows(row, [&](std::int64_t from) { return workspace_row(which, from); });
      }
      float* out = squares();
      for (std::int64_t i = 0; i < layout_.rounded; i += static_cast<std::int64_t>(hn::Lanes(d))) {
        const auto x = hn::Load(d, this->x() + i);
        const auto y = hn::Load(d, this->y() + i);
        const auto by_mean = sum_rows(rows[0], i);
        const auto by_squares = sum_rows(rows[1], i);
        const auto by_product = sum_rows(rows[2], i);
        const auto ssim = hn::MulAdd(hn::Add(x, x), by_squares, hn::MulAdd(y, by_product, by_mean));
        const auto difference = hn::Sub(x, y);
        const auto sign = hn::IfThenElse(hn::Eq(difference, zero), zero, hn::CopySign(l1_scale, difference));
        const auto weight = hn::Load(d, this->weight() + i);
        hn::Store(hn::Mul(weight, hn::MulAdd(ssim_scale, ssim, sign)), d, out + i);
      }
      std::memcpy(args_.grad + row * layout_.n, out, static_cast<std::size_t>(layout_.n) * sizeof(float));
    }
  }

 private:
  // Rows of the scratch.
  float* zeros() { return scratch_row(0); }
  float* weight() { return scratch_row(1); }                       // 1 = valid pixel, 0 = invalid or past the row's end
  float* x() { return scratch_row(2); }                            // rendered
  float* y() { return scratch_row(3); }                            // truth
  float* squares() { return scratch_row(4); }                      // x^2 + y^2
  float* product() { return scratch_row(5); }                      // x y
  float* derivative(int which) { return scratch_row(6 + which); }  // which is 0 to 2
  /// Returns the horizontally filtered x, y, squares or product (`which` 0 to 3) of an image row.
  float* ring(int which, std::int64_t image_row) {
    return scratch_row(9 + kTaps * which + static_cast<int>(image_row % kTaps));
  }
  static constexpr std::int64_t kScratchRows = 9 + 4 * kTaps;
  float* scratch_row(int index) { return scratch_.get() + index * layout_.stride() + kPadding; }

  /// Rows of the window around an image row, from row_at(). Rows outside the image are zeros.
  using WindowRows = std::array<const float*, kTaps>;
  template <class RowAt>
  WindowRows window_rows(std::int64_t center, RowAt&& row_at) {
    WindowRows rows;
    for (int tap = 0; tap < kTaps; ++tap) {
      const std::int64_t row = center + tap - kRadius;
      rows[tap] = row >= 0 && row < args_.height ? row_at(row) : zeros();
    }
    return rows;
  }

  /// Returns a row of horizontally filtered derivatives.
  float* workspace_row(int which, std::int64_t row) const {
    return args_.workspace + (which * static_cast<std::int64_t>(args_.height) + row) * layout_.rounded;
  }

  /// Loads x, y and, with a mask, the weights of an image row.
  void load_row(std::int64_t row) {
    float *x = this->x(), *y = this->y();
    std::memcpy(x, args_.rendered + row * layout_.n, static_cast<std::size_t>(layout_.n) * sizeof(float));
    const std::uint8_t* truth = args_.truth + row * layout_.n;
    for (std::int64_t i = 0; i < layout_.n; ++i) y[i] = static_cast<float>(truth[i]) / 255.0f;
    if (!args_.valid) return;
    load_weight(row);
    for (std::int64_t i = 0; i < layout_.n; ++i) {
      if (weight()[i] == 0) x[i] = y[i] = 0;
    }
  }

  void load_weight(std::int64_t row) {
    const std::uint8_t* valid = args_.valid + row * args_.width;
    for (std::int64_t i = 0; i < layout_.n; ++i) weight()[i] = valid[i / 3] != 0 ? 1.0f : 0.0f;
  }

  /// Computes squares and product. Returns the sum of |x - y|.
  double multiply_row() {
    const FloatTag d;
    auto sum = hn::Zero(d);
    for (std::int64_t i = 0; i < layout_.rounded; i += static_cast<std::int64_t>(hn::Lanes(d))) {
      const auto x = hn::Load(d, this->x() + i);
      const auto y = hn::Load(d, this->y() + i);
      hn::Store(hn::MulAdd(x, x, hn::Mul(y, y)), d, squares() + i);
      hn::Store(hn::Mul(x, y), d, product() + i);
      sum = hn::Add(sum, hn::Abs(hn::Sub(x, y)));
    }
    return hn::GetLane(hn::SumOfLanes(d, sum));
  }

  static HWY_INLINE FloatVec weight_at(int distance) { return hn::Set(FloatTag(), ssim_weight(distance)); }

  /// Filters a row horizontally. `in` has zero padding. `out` is written in whole vectors.
  void filter_row(const float* in, float* out) const {
    const FloatTag d;
    for (std::int64_t i = 0; i < layout_.rounded; i += static_cast<std::int64_t>(hn::Lanes(d))) {
      auto sum = hn::Mul(weight_at(0), hn::Load(d, in + i));
      for (int k = 1; k <= kRadius; ++k) {
        sum = hn::MulAdd(weight_at(k), hn::Add(hn::LoadU(d, in + i - 3 * k), hn::LoadU(d, in + i + 3 * k)), sum);
      }
      hn::Store(sum, d, out + i);
    }
  }

  HWY_INLINE FloatVec sum_rows(const WindowRows& rows, std::int64_t i) const {
    const FloatTag d;
    auto sum = hn::Mul(weight_at(0), hn::Load(d, rows[kRadius] + i));
    for (int k = 1; k <= kRadius; ++k) {
      sum = hn::MulAdd(weight_at(k), hn::Add(hn::Load(d, rows[kRadius - k] + i), hn::Load(d, rows[kRadius + k] + i)),
                       sum);
    }
    return sum;
  }

  /// Returns the sum of SSIM over a row whose neighbours are in the ring. Writes derivatives to the workspace.
  double ssim_row(std::int64_t center) {
    const FloatTag d;
    std::array<WindowRows, 4> rows;
    for (int which = 0; which < 4; ++which) {
      rows[which] = window_rows(center, [&](std::int64_t row) { return ring(which, row); });
    }
    if (args_.valid) load_weight(center);
    const auto c1 = hn::Set(d, kSsimC1), c2 = hn::Set(d, kSsimC2), one = hn::Set(d, 1.0f);
    auto sum = hn::Zero(d);
    for (std::int64_t i = 0; i < layout_.rounded; i += static_cast<std::int64_t>(hn::Lanes(d))) {
      const auto mx = sum_rows(rows[0], i);  // window means
      const auto my = sum_rows(rows[1], i);
      const auto mean_squares = sum_rows(rows[2], i);
      const auto mean_product = sum_rows(rows[3], i);
      const auto mx_my = hn::Mul(mx, my);
      const auto means_squared = hn::MulAdd(mx, mx, hn::Mul(my, my));
      const auto covariance = hn::Sub(mean_product, mx_my);
      // SSIM = a1 a2 / (b1 b2)
      const auto a1 = hn::Add(hn::Add(mx_my, mx_my), c1);
      const auto a2 = hn::Add(hn::Add(covariance, covariance), c2);
      const auto b1 = hn::Add(means_squared, c1);
      const auto b2 = hn::Add(hn::Sub(mean_squares, means_squared), c2);
      const auto inverse = hn::Div(one, hn::Mul(b1, b2));
      const auto weight = hn::Load(d, this->weight() + i);
      const auto ssim = hn::Mul(hn::Mul(a1, a2), inverse);
      // The windows past the row's end still overlap the row, so the weight is needed.
      sum = hn::MulAdd(weight, ssim, sum);
      if (!args_.grad) continue;
      const auto weighted = hn::Mul(weight, inverse);
      const auto by_mean =
          hn::Mul(weighted, hn::MulAdd(my, hn::Sub(a2, a1), hn::Mul(hn::Mul(mx, ssim), hn::Sub(b1, b2))));
      hn::Store(hn::Add(by_mean, by_mean), d, derivative(0) + i);
      hn::Store(hn::Neg(hn::Mul(weighted, hn::Mul(ssim, b1))), d, derivative(1) + i);
      const auto by_product = hn::Mul(weighted, a1);
      hn::Store(hn::Add(by_product, by_product), d, derivative(2) + i);
    }
    if (args_.grad) {
      for (int which = 0; which < 3; ++which) filter_row(derivative(which), workspace_row(which, center));
    }
    return hn::GetLane(hn::SumOfLanes(d, sum));
  }

  const LossArgs& args_;
  RowLayout layout_;
  hwy::AlignedFreeUniquePtr<float[]> scratch_;
};

}  // namespace

RowSums compute_loss_sums(const LossArgs& args) {
  const std::int64_t n_bands = (args.height + kBandRows - 1) / kBandRows;
  std::vector<std::unique_ptr<BandLoss>> by_thread(static_cast<std::size_t>(thread_count()));
  const auto band_loss = [&](int thread) -> BandLoss& {
    auto& own = by_thread[static_cast<std::size_t>(thread)];
    if (!own) own = std::make_unique<BandLoss>(args);
    return *own;
  };
  const auto band_end = [&](std::int64_t band) { return std::min<std::int64_t>((band + 1) * kBandRows, args.height); };
  std::vector<RowSums> rows(static_cast<std::size_t>(args.height));
  parallel_pool(n_bands, [&](std::int64_t band, int thread) {
    band_loss(thread).value(band * kBandRows, band_end(band), rows.data());
  });
  if (args.grad) {
    parallel_pool(n_bands,
                  [&](std::int64_t band, int thread) { band_loss(thread).gradient(band * kBandRows, band_end(band)); });
  }
  RowSums total;
  for (const RowSums& row : rows) {
    total.l1 += row.l1;
    total.ssim += row.ssim;
  }
  return total;
}

}  // namespace b3dgs::cpu::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace b3dgs::cpu {

HWY_EXPORT(compute_loss_sums);

std::int64_t loss_workspace_size(std::int32_t width, std::int32_t height) {
  return 3 * static_cast<std::int64_t>(height) * RowLayout(width).rounded;
}

LossValue compute_loss(const LossArgs& args) {
  B3DGS_CHECK(!args.grad || args.workspace, "the gradient of the loss needs a workspace");
  if (args.n_valid == 0) {
    if (args.grad) std::fill_n(args.grad, 3 * static_cast<std::int64_t>(args.width) * args.height, 0.0f);
    return {};
  }
  const RowSums sums = HWY_DYNAMIC_DISPATCH(compute_loss_sums)(args);
  const double n_values = 3.0 * static_cast<double>(args.n_valid);
  return weighted_loss(args.weights, sums.l1 / n_values, sums.ssim / n_values);
}

}  // namespace b3dgs::cpu
#endif  // HWY_ONCE
