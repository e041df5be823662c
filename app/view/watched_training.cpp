#include "app/view/watched_training.h"

#include <algorithm>
#include <cmath>

#include "core/check.h"
#include "core/text.h"
#include "model/model_folder.h"
#include "scene/images/image.h"
#include "train/device.h"
#include "train/evaluate.h"
#include "train/poses/pose_refiner.h"

namespace b3dgs {
namespace {

constexpr double kShare = 0.05;                                 // of the time, for frames
constexpr double kReserveSeconds = 0.1, kDraftSeconds = 0.025;  // of what FrameBudget saves
constexpr double kLeastPixels = 16000;                          // below, a frame takes hardly less time
constexpr double kRefreshSeconds = 1;                           // between frames if there is time
constexpr std::size_t kMaxCurve = 2000;                         // points; then every second one is dropped

/// Calls `first` with the arguments of `hook`, before it.
template <class... Args, class First>
void call_before(std::function<void(Args...)>& hook, First first) {
  hook = [first, next = hook](Args... args) {
    first(args...);
    if (next) next(args...);
  };
}

ViewedScene viewed_training(const Scene& scene) {
  ViewedScene viewed = viewed_scene(scene, scene.points.positions, scene_name(scene.source_path));
  viewed.is_training = true;
  return viewed;
}

}  // namespace

bool FrameBudget::allows(double now_s) {
  if (last_s_ >= 0) saved_s_ = std::min(kMostSavedSeconds, saved_s_ + share_ * (now_s - last_s_));
  last_s_ = now_s;
  return saved_s_ >= 0;
}

double FrameBudget::pixels(bool is_draft) const {
  if (pixel_s_ == 0) return kLeastPixels;
  const double seconds = is_draft ? kDraftSeconds : std::max(kDraftSeconds, saved_s_ - kReserveSeconds);
  return std::max(kLeastPixels, seconds / (is_draft ? draft_pixel_s_ : pixel_s_));
}

double FrameBudget::wait_s(double pixels, double unpaid_s) const {
  const double needed_s = std::min(kMostSavedSeconds, kReserveSeconds + pixels * pixel_s_);
  return std::max(0.0, (needed_s - saved_s_ + unpaid_s) / share_);
}

void FrameBudget::learn(double seconds, double pixels, bool is_draft) {
  const double measured_s = seconds / pixels;
  if (pixel_s_ == 0) pixel_s_ = draft_pixel_s_ = measured_s;
  double& learned_s = is_draft ? draft_pixel_s_ : pixel_s_;
  learned_s = (learned_s + measured_s) / 2;
}

WatchedTraining::WatchedTraining(const FinalConfig& config, const Scene& scene, std::function<void()> stop)
    : WatchedScene(scene, viewed_training(scene), config.device),
      config_(config.options),
      stop_(std::move(stop)),
      budget_(kShare),
      eta_(config_.iterations) {
  state_.iterations = config_.iterations;
  state_.activity = "starting";
}

void WatchedTraining::attach(TrainHooks& hooks) {
  stop_signal_ = hooks.stop_signal;
  call_before(hooks.on_progress, [this](const TrainProgress& progress) { note_progress(progress); });
  call_before(hooks.on_evaluation, [this](int iteration, const Evaluation& evaluation) {
    const std::lock_guard<std::mutex> lock(mutex_);
    state_.psnr.push_back({iteration, evaluation.mean.psnr});
  });
  call_before(hooks.on_warning, [this](const std::string& warning) { set_notice(warning, true); });
  hooks.wants_model = [this] { return wants_model(); };
  hooks.on_model = [this](const ModelInTraining& model) { show(model); };
}

void WatchedTraining::note_progress(const TrainProgress& progress) {
  const std::lock_guard<std::mutex> lock(mutex_);
  eta_.add(progress.iteration, progress.elapsed_s);
  state_.iteration = progress.iteration;
  state_.iterations = progress.iterations;
  state_.loss = progress.loss;
  state_.n_gaussians = progress.n_gaussians;
  state_.activity = progress.activity;
  std::vector<CurvePoint>& curve = state_.curve;
  const bool is_due = curve.empty() || progress.iteration >= curve.back().iteration + curve_spacing_;
  if (progress.iteration == 0 || !is_due) return;
  curve.push_back({progress.iteration, progress.loss, progress.n_gaussians});
  if (curve.size() < kMaxCurve) return;
  curve_spacing_ *= 2;
  std::size_t kept = 0;
  for (std::size_t i = 0; i < curve.size(); i += 2) curve[kept++] = curve[i];
  curve.resize(kept);
}

bool WatchedTraining::wants_model() {
  if (is_paused_ || is_to_save_) return true;
  return queue_.has_request() && budget_.allows(steady_seconds());
}

void WatchedTraining::show(const ModelInTraining& model) {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    state_.kernel = model.kernel;
  }
  if (is_to_save_.exchange(false)) save_now();
  if (!is_paused_) {
    const double start_s = steady_seconds();
    queue_.serve([&](const FrameRequest& request) { return paint_within_budget(request, model); },
                 std::chrono::milliseconds(0));
    budget_.spend(steady_seconds() - start_s);
  }
  while (is_paused_ && !is_stopped()) {
    queue_.serve([&](const FrameRequest& request) { return paint(request, model); }, std::chrono::milliseconds(50));
    if (is_to_save_.exchange(false)) save_now();
  }
}

Frame WatchedTraining::paint(const FrameRequest& request, const ModelInTraining& model) {
  FrameRequest wanted = request;
  if (request.view >= 0) {  // at the pose to which pose refinement has moved the view
    const View& view = view_at(source_, request.view);
    const std::vector<View> refined = with_refined_poses({view}, source_.train, model.poses);
    wanted.camera = refined.front().camera.scaled_to(request.camera.width, request.camera.height);
  }
  Frame frame = WatchedScene::paint(wanted, model.gaussians, base_render_settings(config_, model.sh_degree));
  frame.iteration = model.iteration;
  frame.wait_s = request.is_draft ? 0 : kRefreshSeconds;
  return frame;
}

Frame WatchedTraining::paint_within_budget(const FrameRequest& request, const ModelInTraining& model) {
  const double start_s = steady_seconds();
  const auto n_pixels = [](const Camera& camera) { return 1.0 * camera.width * camera.height; };
  const double wanted = n_pixels(request.camera);
  const double scale = std::min(1.0, std::sqrt(budget_.pixels(request.is_draft) / wanted));
  FrameRequest reduced = request;
  if (scale < 1) {
    const auto side = [&](int full) { return std::max(1, static_cast<int>(scale * full)); };
    reduced.camera = request.camera.scaled_to(side(request.camera.width), side(request.camera.height));
    if (request.photograph) {
      reduced.photograph =
          std::make_shared<Image8>(resize_image(*request.photograph, reduced.camera.width, reduced.camera.height));
    }
  }
  Frame frame = paint(reduced, model);
  const double spent_s = steady_seconds() - start_s;
  budget_.learn(spent_s, n_pixels(reduced.camera), request.is_draft);
  const double wait_s = budget_.wait_s(wanted, spent_s);
  frame.wait_s = scale < 1 ? wait_s : std::max(frame.wait_s, wait_s);
  return frame;
}

void WatchedTraining::save_now() {
  try {
    set_notice("saved " + save_().filename().string(), false);
  } catch (const std::exception& error) {
    set_notice(std::string("not saved: ") + error.what(), true);
  }
}

void WatchedTraining::set_notice(const std::string& notice, bool is_warning) {
  const std::lock_guard<std::mutex> lock(mutex_);
  state_.notice = notice;
  state_.is_warning = is_warning;
}

void WatchedTraining::finish(const TrainResult& result) {
  const bool has_ply = !ModelFolder(config_.model_path).ply_iterations().empty();
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    state_.has_ended = true;
    state_.iteration = result.iteration;
    state_.n_gaussians = result.n_gaussians;
    state_.activity = result.interrupted ? "stopped" : "finished";
    if (has_ply && !state_.is_warning) {
      state_.notice = "To view the model: b3dgs view " + shell_quote(config_.model_path);
    }
  }
  close();
}

void WatchedTraining::close() {
  WatchedScene::close();
  const std::lock_guard<std::mutex> lock(mutex_);
  is_paused_ = false;
  if (state_.has_ended) return;
  state_.has_ended = state_.is_warning = true;
  state_.activity = is_stopped() ? "stopped" : "failed";
  state_.notice = "See the terminal.";
}

ViewState WatchedTraining::state(int since) const {
  const std::lock_guard<std::mutex> lock(mutex_);
  ViewState state = state_;
  state.is_paused = is_paused_;
  if (state.is_paused) state.activity = "paused";
  state.iterations_per_second = eta_.iterations_per_second();
  state.eta_s = eta_.seconds_left();
  const auto first =
      std::upper_bound(state.curve.begin(), state.curve.end(), since,
                       [](int iteration, const CurvePoint& point) { return iteration < point.iteration; });
  state.curve.erase(state.curve.begin(), first);
  return state;
}

void WatchedTraining::command(ViewCommand command) {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (state_.has_ended) return;
  if (command == ViewCommand::kSave) {
    is_to_save_ = true;
  } else if (command == ViewCommand::kStop) {
    stop_();
  } else {
    is_paused_ = command == ViewCommand::kPause;
  }
}

}  // namespace b3dgs
