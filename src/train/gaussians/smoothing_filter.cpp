#include "train/gaussians/smoothing_filter.h"

#include <algorithm>
#include <utility>

#include "core/parallel.h"
#include "raster/torch/tensors.h"
#include "raster/torch/torch_cuda.h"

namespace b3dgs {

SmoothingFilter::SmoothingFilter(const std::vector<CameraView>& views, float near_plane, torch::Device device)
    : near_plane_(near_plane), n_views_(static_cast<std::int32_t>(views.size())) {
  const auto bytes = torch::TensorOptions(torch::kUInt8);
  views_ = torch::empty({static_cast<std::int64_t>(views.size() * sizeof(FilterView))}, bytes);
  auto* const rows = reinterpret_cast<FilterView*>(views_.data_ptr<std::uint8_t>());
  std::transform(views.begin(), views.end(), rows, [](const CameraView& view) {
    return FilterView{make_view_transform<float>(view), static_cast<float>(view.width),
                      static_cast<float>(view.height)};
  });
  views_ = views_.to(device);
}

void SmoothingFilter::compute(GaussianTensors& gaussians, const FindLargest& find_largest) {
  constexpr std::int64_t kSparePart = 8;
  const bool on_gpu = gaussians.means.is_cuda();
  torch::Tensor filters = std::exchange(gaussians.filters, {});  // undefined if this fails
  place_tensor(filters, storage_, {gaussians.size()}, gaussians.means.options(), kSparePart);
  SmoothingFilterArgs args;
  args.means = gaussians.means.data_ptr<float>();
  args.n_views = n_views_;
  args.views = reinterpret_cast<const FilterView*>(views_.data_ptr<std::uint8_t>());
  args.near_plane = near_plane_;
  args.filters = filters.data_ptr<float>();
  for_rows<write_finest_pixel>(on_gpu, args, gaussians.size());
  torch::Tensor largest = gaussians.size() > 0 ? filters.amax().view({1}) : torch::zeros({1}, filters.options());
  if (find_largest) find_largest(largest);
  args.largest = largest.data_ptr<float>();
  for_rows<write_filter_size>(on_gpu, args, gaussians.size());
  gaussians.filters = filters;
}

}  // namespace b3dgs
