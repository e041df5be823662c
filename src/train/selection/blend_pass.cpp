#include "train/selection/blend_pass.h"

#include <torch/types.h>

#include "train/selection/kernel_agreement.h"

namespace b3dgs {
namespace {

class ForwardBlend final : public BlendPass {
 public:
  explicit ForwardBlend(const BlendInput& input) : input_(input) {}

  void prepare(const PinholeView& view) override { input_.forward(view); }
  void run(const std::string& kernel) override { image_ = input_.rasterizer.reblend(forward_kernel(kernel)); }
  void keep() override { kept_ = {image_.color.clone(), {}, image_.alpha.clone()}; }
  std::string fault() const override { return image_fault(image_, kept_); }

 private:
  const BlendInput& input_;
  RenderedView image_, kept_;
};

class BackwardBlend final : public BlendPass {
 public:
  explicit BackwardBlend(const BlendInput& input) : input_(input) {}

  void prepare(const PinholeView& view) override {
    const torch::Tensor color = input_.forward(view).color;
    // The amount of work does not depend on the gradient's values; this one is nonzero at every pixel.
    grad_.color = torch::full_like(color, 1.0 / static_cast<double>(color.numel()));
  }
  void run(const std::string& kernel) override {
    sums_ = input_.rasterizer.reblend_backward(backward_kernel(kernel), grad_);
  }
  void keep() override { kept_ = sums_.clone(); }
  std::string fault() const override { return gradient_fault(sums_, kept_); }

 private:
  const BlendInput& input_;
  RenderedViewGrad grad_;
  torch::Tensor sums_, kept_;
};

}  // namespace

std::unique_ptr<BlendPass> make_forward_blend(const BlendInput& input) {
  return std::make_unique<ForwardBlend>(input);
}

std::unique_ptr<BlendPass> make_backward_blend(const BlendInput& input) {
  return std::make_unique<BackwardBlend>(input);
}

}  // namespace b3dgs
