// The rasterizer of one device, without torch. Two implementations: cpu::make_rasterizer() and cuda::make_rasterizer().
#pragma once

#include <cstdint>
#include <functional>
#include <vector>

#include "core/check.h"
#include "raster/args.h"
#include "raster/stages.h"

namespace b3dgs {

namespace cuda {
struct ProjectBackwardCudaArgs;  // cuda/passes.h
}

/// What a backend knows of the view of its last forward pass.
struct LastView {
  CameraView view{};
  RenderSettings settings{};
  TileGrid grid{};
  std::int64_t n_gaussians = -1;   // -1: no view, or of forward_splats()
  std::int64_t n_given_rows = -1;  // to forward_splats(); -1: no view, or of forward()
  std::int64_t n_splats = 0;
  bool has_camera_gradient = false;
  ImageArrays rendered{};

  void forget_view() { n_gaussians = n_given_rows = -1; }
  /// Before projection. Until all passes have succeeded, there is no view.
  void begin_view(const CameraView& next_view, const TileGrid& next_grid, const RenderSettings& next_settings) {
    forget_view();
    view = next_view;
    grid = next_grid;
    settings = next_settings;
    has_camera_gradient = false;
  }

  // @throws LogicError if there was no such forward pass
  void check_view(const char* call) const {
    B3DGS_CHECK(n_gaussians >= 0 || n_given_rows >= 0, call, " before any forward()");
  }
  void check_gaussians(const char* call) const { B3DGS_CHECK(n_gaussians >= 0, call, " before any forward()"); }
  void check_rows(const char* call) const { B3DGS_CHECK(n_given_rows >= 0, call, " before any forward_splats()"); }
  void check_family(ForwardKernel kernel) const {
    B3DGS_CHECK(family_of(kernel) == family_of(settings.kernel), kernel_name(kernel), " on the lists of ",
                kernel_name(settings.kernel), ", which is of the other family");
  }
  void check_same(const GaussianArrays& gaussians) const {
    B3DGS_CHECK(n_gaussians == gaussians.n_gaussians, "backward() with ", gaussians.n_gaussians,
                " Gaussians after a forward() with ", n_gaussians, " (-1: none)");
  }
};

/// How well a kernel fills a GPU in one launch (bench paper).
struct KernelOccupancy {
  int registers = 0;         // of a thread
  int shared_bytes = 0;      // of a block
  int blocks = 0;            // resident on a multiprocessor at the same time
  double theoretical = 0;    // resident warps divided by the most that a multiprocessor takes
  const char* limiter = "";  // what limits the number of blocks: registers, shared memory, warps or blocks
  // Measured in a launch: resident warps, averaged over the time in which a multiprocessor has any, divided by the
  // most; and that time's share of the launch, averaged over all multiprocessors.
  double achieved = 0, active = 0;
};

/// As Rasterizer, without tensors; torch/rasterizer.h describes the functions of the same name. All arrays are in
/// memory of the device. On a GPU the passes are asynchronous: only forward(), project(), wait_for_projections() and
/// forward_splats() wait, for numbers of splats and pairs and for valid colours. On the CPU they use thread_count()
/// threads (core/parallel.h); results do not depend on their number.
/// @throws what its passes throw: LogicError for arguments that do not fit, InvalidGaussianError naming the first
/// invalid Gaussian, NumericError for too many pairs, CudaError
class RasterizerBackend {
 public:
  virtual ~RasterizerBackend() = default;

  virtual void forward(const GaussianArrays& gaussians, const CameraView& view, const RenderSettings& settings,
                       const ImageArrays& out) = 0;

  /// `gaussians` and the images that forward() wrote must be unchanged.
  virtual void backward(const GaussianArrays& gaussians, const ImageGradArrays& grad,
                        const GaussianGradArrays& out) = 0;

  /// `rest`: the arguments of project_backward(), valid until the next forward().
  virtual void backward_blend(const GaussianArrays& /*gaussians*/, const ImageGradArrays& /*grad*/, float* /*means2d*/,
                              cuda::ProjectBackwardCudaArgs& /*rest*/) {
    needs_gpu("backward_blend()");
  }

  virtual void backward_to_splats(const GaussianArrays& gaussians, const ImageGradArrays& grad,
                                  const SplatRecordArrays& out) = 0;

  /// Writes to the memory that `allocate` returns. Returns how many of the splats a panorama draws twice.
  virtual std::int64_t project(const GaussianArrays& gaussians, const CameraView& view, const RenderSettings& settings,
                               const SplatAllocator& allocate) = 0;

  /// project() for view number `index` of several, on a GPU, without waiting: writes at most `capacity` splats to
  /// `out`. Then the next one, or wait_for_projections().
  virtual void queue_projection(std::size_t /*index*/, const GaussianArrays& /*gaussians*/, const CameraView& /*view*/,
                                const RenderSettings& /*settings*/, const SplatRowArrays& /*out*/,
                                std::int64_t /*capacity*/) {
    needs_gpu("queue_projection()");
  }
  /// Numbers of splats of the views that were queued, in their order, all of them also if they exceed the capacity.
  virtual std::vector<SplatCounts> wait_for_projections() { needs_gpu("wait_for_projections()"); }

  virtual void forward_splats(const SplatRows& rows, const CameraView& view, const RenderSettings& settings,
                              const ImageArrays& out) = 0;
  /// `out`: [M], a row for each of forward_splats().
  virtual void backward_splats(const ImageGradArrays& grad, SplatGradSum* out) = 0;

  /// `error`: [H, W] (ScoreArgs). Overwrites memory of backward(), so that it allocates nothing after one.
  virtual void score(const float* error, const ScoreArrays& out) = 0;
  /// `out`: [M] as for backward_splats().
  virtual void score_splats(const float* error, ScoreSums* out) = 0;

  /// `kernel`: of the family of forward()'s.
  virtual void reblend(ForwardKernel kernel) = 0;
  /// Into splat_grads().
  virtual void reblend_backward(const ImageGradArrays& /*grad*/) { needs_gpu("reblend_backward()"); }
  virtual KernelOccupancy measure_occupancy(ForwardKernel /*kernel*/) { needs_gpu("measure_occupancy()"); }

  /// [H, W] each (CountLoadArgs).
  virtual void count_load(std::int32_t* processed, std::int32_t* contributing) const = 0;

  /// [kCameraGradients] of the last backward(), after a forward() with camera_gradient.
  virtual const double* camera_gradient() const = 0;

  /// Of a GPU: [n_rows(), 12] floats, the splats' sums of the last backward blend, of which the first 10 are a
  /// SplatGrad. Rows without a splat are undefined, except after reblend_backward().
  virtual const float* splat_grads() const { return nullptr; }

  // Of the last forward():
  virtual const std::int32_t* radii() const = 0;     // [N]
  virtual const std::int32_t* last_ids() const = 0;  // [H, W]
  virtual const Splat* splats() const = 0;           // [n_rows()] indexed by bins().splat_ids
  /// On the CPU the number of splats, on a GPU that of rows of cuda::ProjectOutputs, which may have no splat.
  virtual std::int64_t n_rows() const { return state_.n_splats; }
  virtual BinnedSplats bins() const = 0;
  const TileGrid& grid() const { return state_.grid; }
  std::int64_t n_splats() const { return state_.n_splats; }
  const LastView& view_state() const { return state_; }
  /// There is no last forward() from here on.
  void forget_view() { state_.forget_view(); }

  /// Of all buffers of a GPU, which are kept from view to view (view_memory.h forecasts it).
  virtual std::int64_t memory_bytes() { return 0; }
  virtual void release_memory() {}

 protected:
  /// Blends forward() or forward_splats(): run(kernel), or as the settings say.
  void run_forward_blend(const std::function<void(ForwardKernel)>& run) const {
    if (state_.settings.run_blend == nullptr) return run(state_.settings.kernel);
    (*state_.settings.run_blend)([&](ForwardKernel kernel) {
      state_.check_family(kernel);
      run(kernel);
    });
  }
  void check_camera_gradient() const {
    B3DGS_CHECK(state_.has_camera_gradient,
                "camera_gradient() without a forward() with camera_gradient and its backward()");
  }

  LastView state_;

 private:
  [[noreturn]] static void needs_gpu(const char* call) {
    throw LogicError(detail::concat(call, " on the CPU: needs a forward() on a GPU before"));
  }
};

}  // namespace b3dgs
