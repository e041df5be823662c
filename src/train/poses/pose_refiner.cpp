#include "train/poses/pose_refiner.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <string>

#include "core/check.h"
#include "core/vec.h"
#include "model/raster_input.h"
#include "train/optimizer/adam.h"
#include "train/optimizer/adam_args.h"

namespace b3dgs {
namespace {

std::array<double, kCameraGradients> numbers_of(const CameraCorrection& correction) {
  const Vec3d &r = correction.rotation, &t = correction.translation;
  return {r.x, r.y, r.z, t.x, t.y, t.z};
}

}  // namespace

PoseState PoseState::make(std::int64_t n_views) {
  const torch::Tensor zeros = torch::zeros({n_views, kCameraGradients}, torch::kFloat32);
  return {zeros, zeros.clone(), zeros.clone(), torch::zeros({n_views}, torch::kInt32)};
}

CameraCorrection PoseState::correction(std::size_t view) const {
  const float* const row = corrections.data_ptr<float>() + kCameraGradients * view;
  return {{row[0], row[1], row[2]}, {row[3], row[4], row[5]}};
}

std::vector<View> with_refined_poses(std::vector<View> views, const std::vector<View>& train, const PoseState& state) {
  if (!state.is_defined()) return views;
  std::map<std::string, Pose> refined;
  for (std::size_t i = 0; i < train.size(); ++i) {
    refined[train[i].name] = corrected(train[i].camera.cam_from_world, state.correction(i));
  }
  for (View& view : views) {
    if (const auto found = refined.find(view.name); found != refined.end()) view.camera.cam_from_world = found->second;
  }
  return views;
}

bool PoseRefiner::refines(std::int32_t view, int iteration) const {
  const auto last = static_cast<std::int32_t>(scene_.train.size()) - 1;
  return config_.pose_opt && iteration > config_.densify_from_iter && view > 0 && view < last;
}

CameraView PoseRefiner::camera(std::int32_t view, int iteration) {
  if (refines(view, iteration)) make_room();
  const auto is_of_view = [&](const Unfinished& step) { return step.view == view; };
  if (std::any_of(unfinished_.begin(), unfinished_.end(), is_of_view)) take_queued_steps();
  Camera camera = scene_.train[static_cast<std::size_t>(view)].camera;
  if (state_.is_defined()) {
    camera.cam_from_world = corrected(camera.cam_from_world, state_.correction(static_cast<std::size_t>(view)));
  }
  return to_camera_view(camera);
}

void PoseRefiner::make_room() {
  if (!state_.is_defined()) state_ = PoseState::make(static_cast<std::int64_t>(scene_.train.size()));
  const auto n_views = static_cast<std::size_t>(config_.batch);
  if constexpr (kTorchHasCuda) {
    while (config_.device == "cuda" && copies_.size() < n_views) copies_.emplace_back(sizeof(CameraGrad));
  }
  if (copies_.empty()) grads_.resize(n_views);
}

void PoseRefiner::add_gradient(std::int32_t view, int iteration, const torch::Tensor& camera_grad) {
  B3DGS_CHECK(unfinished_.empty(), "add_gradient() before take_queued_steps()");
  B3DGS_CHECK(camera_grad.defined() && camera_grad.numel() == kCameraGradients,
              "no gradient with respect to the camera");
  const double* const values = camera_grad.data_ptr<double>();
  const std::size_t place = added_.size();
  added_.push_back({view, iteration});
  if (kTorchHasCuda && camera_grad.is_cuda()) return copies_.at(place).copy(values);
  std::copy_n(values, kCameraGradients, grads_.at(place).begin());
}

void PoseRefiner::queue_step() {
  B3DGS_CHECK(unfinished_.empty(), "queue_step() before take_queued_steps()");
  unfinished_.swap(added_);
}

void PoseRefiner::take_queued_steps() {
  for (std::size_t place = 0; place < unfinished_.size(); ++place) {
    const Unfinished& step = unfinished_[place];
    take_step(
        step.view, step.iteration,
        kTorchHasCuda && !copies_.empty() ? *static_cast<const CameraGrad*>(copies_[place].wait()) : grads_[place]);
  }
  unfinished_.clear();
}

void PoseRefiner::take_step(std::int32_t view, int iteration, const CameraGrad& grad) {
  constexpr double kMostAngle = 3 * kDegree,
                   kMostDistance = 0.03;  // limits of a correction; the distance is a fraction of the scene extent
  if (!std::all_of(grad.begin(), grad.end(), [](double value) { return std::isfinite(value); })) return;
  const CameraCorrection before = state_.correction(static_cast<std::size_t>(view));
  const CameraCorrection g = correction_grad(before, {{grad[0], grad[1], grad[2]}, {grad[3], grad[4], grad[5]}});
  const CameraGrad gradients = numbers_of(g);
  // Each view has its own step count, so that its first step is as large as the first steps of other views.
  const std::int32_t t = ++state_.steps.data_ptr<std::int32_t>()[view];
  const double bias1 = 1 - std::pow(kAdamBeta1, t), bias2 = 1 - std::pow(kAdamBeta2, t);
  const double rate =
      log_linear_rate(config_.pose_opt_lr, 0.01 * config_.pose_opt_lr, config_.position_lr_max_steps, iteration);
  const std::int64_t row = std::int64_t{kCameraGradients} * view;
  float* const m = state_.adam_m.data_ptr<float>() + row;
  float* const v = state_.adam_v.data_ptr<float>() + row;
  CameraGrad move;
  for (std::size_t k = 0; k < move.size(); ++k) {
    m[k] = static_cast<float>(kAdamBeta1 * m[k] + (1 - kAdamBeta1) * gradients[k]);
    v[k] = static_cast<float>(kAdamBeta2 * v[k] + (1 - kAdamBeta2) * gradients[k] * gradients[k]);
    const double size = k < 3 ? rate : rate * scene_.extent;
    move[k] = size * (m[k] / bias1) / (std::sqrt(v[k] / bias2) + kAdamEpsilon);
  }
  const CameraCorrection after = limited(
      {before.rotation - Vec3d{move[0], move[1], move[2]}, before.translation - Vec3d{move[3], move[4], move[5]}},
      kMostAngle, kMostDistance * scene_.extent);
  const CameraGrad values = numbers_of(after);
  std::copy(values.begin(), values.end(), state_.corrections.data_ptr<float>() + row);
}

}  // namespace b3dgs
