// Adam updates of the SH coefficients beyond degree 0, deferred until a Gaussian becomes visible.
//
// These are 45 of a Gaussian's 59 floats, and Adam changes them in every step, because the moments decay even without a
// gradient. An update is memory-bound (24 bytes per float), and most of it is for Gaussians that the view does not see.
// Therefore, when a Gaussian becomes visible, the pass that reads its coefficients for the colour anyway first applies
// all deferred updates in registers. These are the same operations in the same order as with one update per step, so
// the results are bit-identical. A closed form would round differently. The update of a visible Gaussian is deferred,
// too. It is stored as the gradient with respect to the colour and the direction, whose products are the gradients with
// respect to the coefficients: 32 bytes instead of 180.
#pragma once

#include <array>

#include "raster/cuda/device_buffer.h"
#include "raster/cuda/passes.h"
#include "train/optimizer/adam_args.h"

namespace b3dgs::cuda {

/// The deferred updates of one Gaussian. The gradient of the first one follows from these values. Later ones have
/// gradient 0, because the Gaussian has not been visible since.
struct alignas(32) DeferredUpdate {  // the size of one sector of GPU memory
  float grad_color[3] = {0, 0, 0};
  std::int32_t n_applied = 0;  // number of deferred steps already applied
  float dir[3] = {0, 0, 0};    // unit vector from the camera to the Gaussian
  float decay = 0;             // of the first step (sh_decay.h), unless grad_color is 0
};
static_assert(sizeof(DeferredUpdate) == 32, "two 16-byte words");

/// SH coefficients beyond degree 0 with their Adam moments, [N, K-1, 3] each, where K = (sh_degree_max + 1)^2.
struct ShRestArrays {
  std::int64_t n_gaussians = 0;
  int sh_degree_max = 0;
  float* param = nullptr;
  float* m = nullptr;
  float* v = nullptr;
  bool operator==(const ShRestArrays& other) const {
    return n_gaussians == other.n_gaussians && sh_degree_max == other.sh_degree_max && param == other.param &&
           m == other.m && v == other.v;
  }
};

/// The deferred steps. After kMax steps all Gaussians are flushed, because a thread with many updates keeps its block
/// waiting. A flush costs about as much as one step without deferral, spread over kMax steps.
struct DeferredSteps {
  static constexpr int kMax = 32;
  AdamRule rule{};  // the same for all steps
  int n = 0;
  std::array<AdamStepSize, kMax> sizes{};
};

/// Defers the updates. Each step calls, in this order: begin_view() and a forward pass with this as its ColorPass for
/// each view, begin_step(), a kernel that writes updates(), and defer_step(). All calls are asynchronous.
class DeferredSh final : public ColorPass {
 public:
  /// Sets the coefficients of the next view, which are optimised up to `sh_degree`. Flushes if the degree has changed
  /// or kMax steps are deferred.
  void begin_view(const ShRestArrays& rests, int sh_degree, const LaunchContext& context);

  /// Applies the deferred updates of the visible Gaussians, then computes their colours.
  void color(const ColorCudaArgs& args, const LaunchContext& context) override;

  /// Begins a step along this number of views. Flushes if the number differs from that of the previous step, as in the
  /// last step of a training with --batch, so that all deferred steps have the same rule.
  void begin_step(int n_views, const LaunchContext& context);

  /// Returns the updates, [N]. The kernel of a step along one view writes the entries of the visible Gaussians, with
  /// n_applied = n_deferred(). The kernel of a step along several views steps the coefficients of these Gaussians
  /// itself, so n_applied is n_deferred() + 1.
  DeferredUpdate* updates() const { return updates_.data(); }
  int n_deferred() const { return steps_.n; }
  /// Adds the current step to the deferred ones.
  void defer_step(const AdamStepSize& size);

  /// Applies all deferred updates of all Gaussians. `rests` must be the same as in begin_view().
  void flush(const ShRestArrays& rests, const LaunchContext& context);

 private:
  void clear(std::int64_t n_gaussians, const LaunchContext& context);
  template <bool kColors>
  void apply(const ColorCudaArgs& view, const LaunchContext& context);

  ShRestArrays rests_{};
  int sh_degree_ = 0;
  DeferredSteps steps_{};
  int n_views_ = 1;                       // number of views of each step in steps_
  DeviceBuffer<DeferredUpdate> updates_;  // all 0 while no step is deferred
};

}  // namespace b3dgs::cuda
