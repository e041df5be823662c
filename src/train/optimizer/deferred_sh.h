// Adam updates of the SH coefficients beyond degree 0, deferred until a view sees the Gaussian.
//
// These are 45 of a Gaussian's 59 floats, and Adam moves them in every step: the moments decay even without a gradient.
// An update is memory-bound (24 bytes per float), most of it for Gaussians that the view does not see. So once a view
// sees the Gaussian, the pass that reads its coefficients anyway, to compute the colour, first applies all deferred
// updates in registers: the same operations in the same order as one update per step, hence bit-identical results. A
// closed form would round differently. The update of a Gaussian that was seen is deferred too, as the gradients with
// respect to colour and direction, of which those with respect to the coefficients are products: 32 bytes, not 180.
#pragma once

#include <array>

#include "raster/cuda/device_buffer.h"
#include "raster/cuda/passes.h"
#include "train/optimizer/adam_args.h"

namespace b3dgs::cuda {

/// The deferred updates of one Gaussian. The first one has the gradient that follows from these; later ones have
/// gradient 0, since no view has seen the Gaussian since.
struct alignas(32) DeferredUpdate {  // one sector of GPU memory
  float grad_color[3] = {0, 0, 0};
  std::int32_t n_applied = 0;  // of the deferred steps
  float dir[3] = {0, 0, 0};    // unit vector from the camera to the Gaussian
  float unused = 0;
};
static_assert(sizeof(DeferredUpdate) == 32, "two 16-byte words");

/// SH coefficients beyond degree 0 with their Adam moments, [N, K-1, 3] each.
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

/// The deferred steps. After kMax steps all Gaussians are flushed: a thread with many updates keeps its block waiting.
/// A flush costs about as much as one step without deferral, spread over kMax steps.
struct DeferredSteps {
  static constexpr int kMax = 32;
  AdamRule rule{};  // of all
  int n = 0;
  std::array<AdamStepSize, kMax> sizes{};
};

/// Each step calls, in this order: begin_view() and a forward pass with this as its ColorPass for each view,
/// begin_step(), a kernel that writes updates(), defer_step(). All calls are asynchronous.
class DeferredSh final : public ColorPass {
 public:
  /// Sets the coefficients of the next view, which are optimised up to `sh_degree`. Flushes if the degree has changed
  /// or kMax steps are deferred.
  void begin_view(const ShRestArrays& rests, int sh_degree, const LaunchContext& context);

  /// Applies the deferred updates of the Gaussians that the view sees, then computes their colours.
  void color(const ColorCudaArgs& args, const LaunchContext& context) override;

  /// Of a step along this number of views. If it differs from that of the last step, as in the last step of a training
  /// with --batch, flushes, so that all deferred steps have the same rule.
  void begin_step(int n_views, const LaunchContext& context);

  /// [N] The kernel of a step along one view writes the entries of the Gaussians that the view saw, with n_applied =
  /// n_deferred(). That of a step along several views steps those itself: n_applied is then n_deferred() + 1.
  DeferredUpdate* updates() const { return updates_.data(); }
  int n_deferred() const { return steps_.n; }
  void defer_step(const AdamStepSize& size);

  /// Applies all deferred updates of all Gaussians. `rests` must be what begin_view() was given.
  void flush(const ShRestArrays& rests, const LaunchContext& context);

 private:
  void clear(std::int64_t n_gaussians, const LaunchContext& context);
  template <bool kColors>
  void apply(const ColorCudaArgs& view, const LaunchContext& context);

  ShRestArrays rests_{};
  int sh_degree_ = 0;
  DeferredSteps steps_{};
  int n_views_ = 1;                       // of steps_
  DeviceBuffer<DeferredUpdate> updates_;  // all 0 while no step is deferred
};

}  // namespace b3dgs::cuda
