#include "train/gaussians/smoothing_filter.h"

#include <algorithm>

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
  largest_ = torch::zeros({1}, torch::TensorOptions(torch::kFloat32).device(device));
}

void SmoothingFilter::compute(GaussianTensors& gaussians, const FindLargest& find_largest) {
  constexpr std::int64_t kSparePart = 8;
  place_tensor(gaussians.filters, storage_, {gaussians.size()}, gaussians.means.options(), kSparePart);
  SmoothingFilterArgs args;
  args.n_gaussians = gaussians.size();
  args.means = gaussians.means.data_ptr<float>();
  args.n_views = n_views_;
  args.views = reinterpret_cast<const FilterView*>(views_.data_ptr<std::uint8_t>());
  args.near_plane = near_plane_;
  args.filters = gaussians.filters.data_ptr<float>();
  args.largest = largest_.data_ptr<float>();
  const bool is_on_gpu = gaussians.means.is_cuda();
  if (kTorchHasCuda && is_on_gpu) {
    cuda::find_finest_pixels(args, torch_stream());
  } else {
    for_rows<write_finest_pixel>(args, args.n_gaussians);
    *args.largest = args.n_gaussians > 0 ? *std::max_element(args.filters, args.filters + args.n_gaussians) : 0;
  }
  if (find_largest) find_largest(largest_);
  args.largest = largest_.data_ptr<float>();
  for_rows<write_filter_size>(is_on_gpu, args, args.n_gaussians);
}

}  // namespace b3dgs
