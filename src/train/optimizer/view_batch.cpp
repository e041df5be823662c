#include <algorithm>

#include "config/batch_steps.h"
#include "core/check.h"
#include "core/parallel.h"
#include "raster/torch/tensors.h"
#include "train/optimizer/view_batch.h"

namespace b3dgs {

void ViewBatch::make_room(std::int64_t n_gaussians, std::int64_t n_splats, torch::Device device) {
  B3DGS_CHECK(n_views_ < kMaxBatch, "a step has at most ", kMaxBatch, " views");
  constexpr std::int64_t kWords = sizeof(SplatRecord) / sizeof(float), kSpare = 4;
  if (slots_.size() == static_cast<std::size_t>(n_views_)) slots_.emplace_back();
  Slot& slot = slots_[static_cast<std::size_t>(n_views_)];
  const auto floats = torch::TensorOptions(torch::kFloat32).device(device);
  place_tensor(slot.splats.records, slot.record_room, {n_splats, kWords}, floats, kSpare);
  place_tensor(slot.splats.record_of_gaussian, slot.index_room, {n_gaussians}, floats.dtype(torch::kInt32), kSpare);
}

void ViewBatch::add(const CameraView& view, const RenderSettings& settings, const RegularizationGrad& regularization) {
  if (n_views_ == 0) {
    lenses_.clear();
    has_lenses_ = false;
    sh_degree_ = settings.sh_degree;
    antialiasing_ = settings.antialiasing;
  }
  B3DGS_CHECK(sh_degree_ == settings.sh_degree && antialiasing_ == settings.antialiasing,
              "the views of a step have different settings");
  Slot& slot = slots_[static_cast<std::size_t>(n_views_++)];
  slot.view = view;
  slot.regularization = regularization;
  lenses_.push_back(view.lens);
  has_lenses_ = has_lenses_ || view.lens.kind != LensKind::kPinhole;
}

BatchGradArgs ViewBatch::grad_args(const GaussianArrays& gaussians) const {
  BatchGradArgs args;
  args.gaussians = gaussians;
  args.sh_degree = sh_degree_;
  args.antialiasing = antialiasing_;
  args.n_views = n_views_;
  args.lenses = has_lenses_ ? lenses_.data() : nullptr;
  for (std::size_t v = 0; v < static_cast<std::size_t>(n_views_); ++v) {
    const Slot& slot = slots_[v];
    B3DGS_CHECK(slot.splats.record_of_gaussian.numel() == gaussians.n_gaussians, "a view of ",
                slot.splats.record_of_gaussian.numel(), " Gaussians in a step of ", gaussians.n_gaussians);
    args.views[v] = {slot.view, reinterpret_cast<const SplatRecord*>(slot.splats.records.data_ptr<float>()),
                     slot.splats.record_of_gaussian.data_ptr<std::int32_t>(), slot.regularization};
  }
  return args;
}

std::int64_t ViewBatch::bytes() const {
  std::int64_t bytes = 0;
  for (const Slot& slot : slots_) {
    for (const torch::Tensor* room : {&slot.record_room, &slot.index_room}) {
      if (room->defined()) bytes += static_cast<std::int64_t>(room->storage().nbytes());
    }
  }
  return bytes;
}

}  // namespace b3dgs

namespace b3dgs::cpu {

void batch_gradients(const BatchGradArgs& args, const GaussianGradArrays& out) {
  constexpr std::int64_t kGrain = 1024;
  const std::int64_t rest = rest_floats(args.gaussians.sh_degree_max);
  const float scale = 1.0f / static_cast<float>(args.n_views);
  const auto grad_of = args.lenses == nullptr
                           ? (args.antialiasing ? batch_grad<true, Pinhole> : batch_grad<false, Pinhole>)
                           : (args.antialiasing ? batch_grad<true, ViewLens> : batch_grad<false, ViewLens>);
  parallel_chunks(args.gaussians.n_gaussians, kGrain, [&](std::int64_t begin, std::int64_t end) {
    std::fill(out.shN + rest * begin, out.shN + rest * end, 0.0f);
    for (std::int64_t i = begin; i < end; ++i) {
      float* const own_rest = out.shN + rest * i;
      const BatchGrad grad = grad_of(args, i, args.sh_degree, scale, own_rest);
      store3(out.means, i, grad.mean);
      store3(out.log_scales, i, grad.log_scales);
      store4(out.quats, i, grad.quat);
      out.logit_opacities[i] = grad.logit_opacity;
      store3(out.sh0, i, grad.sh0);
      if (grad.is_seen) std::transform(own_rest, own_rest + rest, own_rest, [&](float sum) { return scale * sum; });
    }
  });
}

}  // namespace b3dgs::cpu
