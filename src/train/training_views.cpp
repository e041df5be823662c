#include "train/training_views.h"

#include "config/coarse_schedule.h"
#include "core/check.h"
#include "raster/torch/tensors.h"
#include "raster/torch/torch_cuda.h"
#include "train/loss/loss.h"

namespace b3dgs {

CameraView reduced_camera(const CameraView& camera, int scale) {
  const auto divisor = static_cast<float>(scale);
  CameraView reduced = camera;
  reduced.fx /= divisor;
  reduced.fy /= divisor;
  reduced.cx /= divisor;
  reduced.cy /= divisor;
  reduced.width /= scale;
  reduced.height /= scale;
  return reduced;
}

std::int64_t ViewReducer::count_valid(const Image8& mask, int scale) {
  const auto [known, is_new] = n_valid_.emplace(std::pair(&mask, scale), 0);
  if (!is_new) return known->second;
  ReduceImageArgs args;
  args.width = mask.width;
  args.height = mask.height;
  args.scale = scale;
  args.valid = mask.pixels.data();
  std::vector<std::uint8_t> reduced(static_cast<std::size_t>(args.n_reduced()));
  args.reduced_valid = reduced.data();
  for_rows<reduce_pixel>(/*on_gpu=*/false, args, args.n_reduced());
  known->second = b3dgs::count_valid(reduced.data(), args.n_reduced());
  return known->second;
}

TrainView ViewReducer::reduce(const TrainView& view, const Image8* mask, int scale) {
  if (scale == 1) return view;
  B3DGS_CHECK(view.valid.defined() == (mask != nullptr), "view ", view.name, ": a mask on one side only");
  TrainView reduced = view;
  reduced.camera = reduced_camera(view.camera, scale);
  const std::int64_t width = reduced.camera.width, height = reduced.camera.height;
  const auto options = torch::TensorOptions(torch::kUInt8).device(device_);
  place_tensor(truth_, truth_room_, {height, width, 3}, options);
  reduced.truth = truth_;
  reduced.n_valid = mask == nullptr ? width * height : count_valid(*mask, scale);

  ReduceImageArgs args;
  args.width = view.camera.width;
  args.height = view.camera.height;
  args.scale = scale;
  args.rgb = view.truth.data_ptr<std::uint8_t>();
  args.reduced = truth_.data_ptr<std::uint8_t>();
  if (view.valid.defined()) {
    place_tensor(valid_, valid_room_, {height, width}, options);
    reduced.valid = valid_;
    args.valid = view.valid.data_ptr<std::uint8_t>();
    args.reduced_valid = valid_.data_ptr<std::uint8_t>();
  }
  if (view.empty.defined()) {
    // A reduced pixel is empty if all pixels that it covers are.
    reduced.empty = view.empty.slice(0, 0, height * scale)
                        .slice(1, 0, width * scale)
                        .reshape({height, scale, width, scale})
                        .amin({1, 3});
  }
  for_rows<reduce_pixel>(device_.is_cuda(), args, args.n_reduced());
  return reduced;
}

int TrainingViews::scale_at(int iteration, const CameraView& camera) const {
  return coarse_scale_of(coarse_scale_at(config_, iteration), camera.width, camera.height);
}

TrainView TrainingViews::take(std::int32_t view, int iteration, const std::vector<std::int32_t>& next) {
  TrainView taken = images.take(view, next);
  taken.camera = poses.camera(view, iteration);
  const Image8* const mask = scene_.train[static_cast<std::size_t>(view)].valid.get();
  return reducer_.reduce(taken, mask, scale_at(iteration, taken.camera));
}

CameraView TrainingViews::camera(std::int32_t view, int iteration) {
  const CameraView camera = poses.camera(view, iteration);
  const int scale = scale_at(iteration, camera);
  return scale == 1 ? camera : reduced_camera(camera, scale);
}

bool EmptyViews::add(std::int32_t view, bool is_empty) {
  is_empty_[static_cast<std::size_t>(view)] = is_empty;
  return ++n_rendered_ == is_empty_.size();
}

std::string EmptyViews::take_warning() {
  const auto n = static_cast<std::size_t>(std::count(is_empty_.begin(), is_empty_.end(), true));
  if (n == 0 || (n <= n_at_warning_ && 2 * n < is_empty_.size())) return "";
  n_at_warning_ = n;
  const auto first = std::find(is_empty_.begin(), is_empty_.end(), true) - is_empty_.begin();
  return detail::concat("no Gaussian is visible in ", n, " of ", is_empty_.size(),
                        " training views (first: ", views_[static_cast<std::size_t>(first)].name, ")");
}

}  // namespace b3dgs
