// Adam for the harmonics beyond degree 0, put off until a view sees the Gaussian.
//
// They are 45 of a Gaussian's 59 floats, and Adam moves them in every step: moments go on where there is no gradient. A
// step is bound by the 24 bytes a float that it reads and writes, most of them for Gaussians that the view does not
// see. Here such a step is owed instead. Once a view sees the Gaussian, the pass that has to read its harmonics anyway,
// for the colour, takes all steps that are owed, in registers: the same operations in the same order as a step at a
// time, so that the bits are the same, whenever that is. The step of a Gaussian that was seen is owed too, as its
// gradient by the colour and the direction, of which the gradients by the harmonics are products: 32 bytes instead of
// 180.
//
// A closed form for the steps in between would be less arithmetic, of which there is enough, but other bits, so that a
// result would depend on when debts are paid.
#pragma once

#include <array>

#include "raster/cuda/passes.h"
#include "train/optimizer/adam_args.h"

namespace b3dgs::cuda {

/// What a Gaussian's harmonics owe. The first step that was not taken has the gradient that follows from these, those
/// after it have none.
struct alignas(32) OwedSteps {  // a sector of the memory
  float grad_color[3] = {0, 0, 0};
  std::int32_t n_taken = 0;  // of the steps put off
  float dir[3] = {0, 0, 0};  // in which the Gaussian was seen, of length 1
  float unused = 0;
};
static_assert(sizeof(OwedSteps) == 32, "two 16-byte words");

/// Harmonics beyond degree 0 with their moments, [N, K-1, 3] each.
struct RestArrays {
  std::int64_t n_gaussians = 0;
  int sh_degree_max = 0;
  float* param = nullptr;
  float* m = nullptr;
  float* v = nullptr;
  bool operator==(const RestArrays& other) const {
    return n_gaussians == other.n_gaussians && sh_degree_max == other.sh_degree_max && param == other.param &&
           m == other.m && v == other.v;
  }
};

/// Steps that were put off. As many as kMax, and all Gaussians take theirs: a thread that takes many keeps its block
/// waiting, and that pass costs what a step would, divided by this.
struct StepSizes {
  static constexpr int kMax = 32;
  int n = 0;
  std::array<AdamStepSize, kMax> sizes{};
};

/// In the course of training: begin_view(), a forward pass with this as its color_pass, a backward pass that writes
/// owed(), put_off_step(). Nothing waits.
class DeferredHarmonics final : public ColorPass {
 public:
  /// Says whose harmonics, learned up to `sh_degree`, the next view will see. What is owed at another degree, or has
  /// become too much, is paid.
  void begin_view(const RestArrays& rests, int sh_degree, const LaunchContext& context);

  /// Colours of harmonics that are up to date, since those of seen Gaussians are brought up to date.
  void color(const ColorCudaArgs& args, const LaunchContext& context) override;

  /// [N] The backward pass writes those of Gaussians that the view saw, with n_put_off() as the steps taken.
  OwedSteps* owed() const { return owed_.data(); }
  int n_put_off() const { return steps_.n; }
  void put_off_step(const AdamStepSize& size);

  /// Takes all steps that are owed. `rests` is what begin_view() was given.
  void settle(const RestArrays& rests, const LaunchContext& context);

 private:
  void clear(std::int64_t n_gaussians, const LaunchContext& context);

  RestArrays rests_{};
  int sh_degree_ = 0;
  StepSizes steps_{};
  DeviceBuffer<OwedSteps> owed_;  // all 0 while no step is put off
};

}  // namespace b3dgs::cuda
