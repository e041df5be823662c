// The rasterizer of one device, without torch. Implemented by cpu::make_rasterizer() and cuda::make_rasterizer().
#pragma once

#include <cstdint>
#include <functional>
#include <vector>

#include "core/check.h"
#include "raster/args.h"
#include "raster/geometry.h"
#include "raster/stages.h"

namespace b3dgs {

namespace cuda {
struct ProjectBackwardCudaArgs;  // cuda/passes.h
}

/// The data that a backend keeps about the view of its last forward pass.
struct LastView {
  CameraView view{};
  RenderSettings settings{};
  TileGrid grid{};
  std::int64_t n_gaussians = -1;   // -1: no view, or a view of forward_splats()
  std::int64_t n_given_rows = -1;  // rows given to forward_splats(); -1: no view, or a view of forward()
  std::int64_t n_splats = 0;
  bool has_camera_gradient = false;
  ImageArrays rendered{};

  void forget_view() { n_gaussians = n_given_rows = -1; }
  /// Must be called before projection. There is no view until all passes have succeeded.
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
  void check_same(const GaussianArrays& gaussians, const char* call = "backward()") const {
    B3DGS_CHECK(n_gaussians == gaussians.n_gaussians, call, " with ", gaussians.n_gaussians,
                " Gaussians after a forward() with ", n_gaussians, " (-1: none)");
  }
};

/// Describes how well a kernel fills a GPU in one launch (bench paper).
struct KernelOccupancy {
  int registers = 0;         // per thread
  int shared_bytes = 0;      // per block
  int blocks = 0;            // resident on a multiprocessor at the same time
  double theoretical = 0;    // resident warps divided by the maximum of a multiprocessor
  const char* limiter = "";  // what limits the number of blocks: registers, shared memory, warps or blocks
  // Measured in a launch. `achieved`: resident warps divided by the maximum, averaged over the time in which a
  // multiprocessor has any. `active`: the fraction of the launch that this time takes, averaged over all
  // multiprocessors.
  double achieved = 0, active = 0;
};

/// Like Rasterizer, but without tensors. torch/rasterizer.h describes the functions of the same name. All arrays are in
/// memory of the device. On a GPU, the passes are asynchronous. Only forward(), project(), wait_for_projections() and
/// forward_splats() wait, for the numbers of splats and pairs and for valid colours. On the CPU, they use
/// thread_count() threads (core/parallel.h), and results do not depend on that number.
/// @throws LogicError for arguments that do not fit, InvalidGaussianError naming the first invalid Gaussian,
/// NumericError for too many pairs, and CudaError
class RasterizerBackend {
 public:
  virtual ~RasterizerBackend() = default;

  virtual void forward(const GaussianArrays& gaussians, const CameraView& view, const RenderSettings& settings,
                       const ImageArrays& out) = 0;

  /// `gaussians` and the images that forward() wrote must be unchanged.
  virtual void backward(const GaussianArrays& gaussians, const ImageGradArrays& grad,
                        const GaussianGradArrays& out) = 0;

  /// `rest` receives the arguments of project_backward(), valid until the next forward().
  virtual void backward_blend(const GaussianArrays& /*gaussians*/, const ImageGradArrays& /*grad*/, float* /*means2d*/,
                              cuda::ProjectBackwardCudaArgs& /*rest*/) {
    needs_gpu("backward_blend()");
  }

  virtual void backward_to_splats(const GaussianArrays& gaussians, const ImageGradArrays& grad,
                                  const SplatRecordArrays& out) = 0;

  /// Writes to the memory that `allocate` returns. Returns the number of splats that a panorama draws twice.
  virtual std::int64_t project(const GaussianArrays& gaussians, const CameraView& view, const RenderSettings& settings,
                               const SplatAllocator& allocate) = 0;

  /// Queues project() for view number `index` of several on a GPU, without waiting. Writes at most `capacity` splats to
  /// `out`. Call it again for the next view, or call wait_for_projections().
  virtual void queue_projection(std::size_t /*index*/, const GaussianArrays& /*gaussians*/, const CameraView& /*view*/,
                                const RenderSettings& /*settings*/, const SplatRowArrays& /*out*/,
                                std::int64_t /*capacity*/) {
    needs_gpu("queue_projection()");
  }
  /// Returns the numbers of splats of the queued views, in order. They may exceed the capacity.
  virtual std::vector<SplatCounts> wait_for_projections() { needs_gpu("wait_for_projections()"); }

  virtual void forward_splats(const SplatRows& rows, const CameraView& view, const RenderSettings& settings,
                              const ImageArrays& out) = 0;
  /// `out`: [M], a row for each splat of forward_splats().
  virtual void backward_splats(const ImageGradArrays& grad, SplatGradSum* out) = 0;

  /// `error`: [H, W] (ScoreArgs). Reuses memory of backward(), so it allocates nothing after one.
  virtual void score(const float* error, const ScoreArrays& out) = 0;
  /// `out`: [M] as for backward_splats().
  virtual void score_splats(const float* error, ScoreSums* out) = 0;

  /// `gaussians` must be unchanged since forward().
  virtual void geometry(const GaussianArrays& gaussians, DepthKind kind, const GeometryArrays& out) = 0;

  /// `kernel` must be of the same family as the kernel of forward().
  virtual void reblend(ForwardKernel kernel) = 0;
  /// Writes to splat_grads().
  virtual void reblend_backward(const ImageGradArrays& /*grad*/) { needs_gpu("reblend_backward()"); }
  virtual KernelOccupancy measure_occupancy(ForwardKernel /*kernel*/) { needs_gpu("measure_occupancy()"); }

  /// Both arrays are [H, W] (CountLoadArgs).
  virtual void count_load(std::int32_t* processed, std::int32_t* contributing) const = 0;

  /// Returns [kCameraGradients] of the last backward(), after a forward() with camera_gradient.
  virtual const double* camera_gradient() const = 0;

  /// GPU only. Returns [n_rows(), 12] floats, the splats' sums of the last backward blend. The first 10 are a
  /// SplatGrad. Rows without a splat are undefined, except after reblend_backward().
  virtual const float* splat_grads() const { return nullptr; }

  // Results of the last forward():
  virtual const std::int32_t* radii() const = 0;     // [N]
  virtual const std::int32_t* last_ids() const = 0;  // [H, W]
  virtual const Splat* splats() const = 0;           // [n_rows()] indexed by bins().splat_ids
  /// Returns the number of splats on the CPU, and on a GPU that of rows of cuda::ProjectOutputs, some without a splat.
  virtual std::int64_t n_rows() const { return state_.n_splats; }
  virtual BinnedSplats bins() const = 0;
  const TileGrid& grid() const { return state_.grid; }
  std::int64_t n_splats() const { return state_.n_splats; }
  const LastView& view_state() const { return state_; }
  /// Forgets the last forward().
  void forget_view() { state_.forget_view(); }

  /// Returns the size of all GPU buffers, which are kept from view to view (view_memory.h forecasts it).
  virtual std::int64_t memory_bytes() { return 0; }
  virtual void release_memory() {}

 protected:
  /// Blends forward() or forward_splats() by calling run(kernel), or as settings.run_blend says.
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
