// The blending of one view, repeatable with any kernel, to compare and time kernels.
#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "raster/torch/rasterizer.h"

namespace b3dgs {

/// The model and the views on which kernels are timed.
struct BlendInput {
  Rasterizer& rasterizer;
  const GaussianTensors& gaussians;
  RenderSettings settings;         // of training steps
  std::vector<PinholeView> views;  // the next views of the training
  // Renders a view and leaves it in `rasterizer`. Empty: rasterizer.forward(gaussians, view, settings).
  std::function<RenderedView(const PinholeView&, const RenderSettings&)> render{};

  RenderedView forward(const PinholeView& view) const {
    return render ? render(view, settings) : rasterizer.forward(gaussians, view, settings);
  }
};

class BlendPass {
 public:
  virtual ~BlendPass() = default;
  /// Everything before blending, and a first blend. @throws NumericError
  virtual void prepare(const PinholeView& view) = 0;
  virtual void run(const std::string& kernel) = 0;
  /// Keeps the result of the last run().
  virtual void keep() = 0;
  /// How the result of the last run() disagrees with the kept one, or "".
  virtual std::string fault() const = 0;
};

/// `input` must outlive the pass.
std::unique_ptr<BlendPass> make_forward_blend(const BlendInput& input);
std::unique_ptr<BlendPass> make_backward_blend(const BlendInput& input);

}  // namespace b3dgs
