// The live view of a training. The trainer's thread renders between two steps what the server's threads ask for.
#pragma once

#include <atomic>
#include <functional>
#include <mutex>

#include "app/terminal/progress.h"
#include "app/view/watched_scene.h"
#include "train/trainer.h"

namespace b3dgs {

/// Which share of the time frames may take. A frame may be begun when the frames before it have been paid for, so that
/// they take no more than the share in the long run; time without frames saves up for a quarter of a second of them.
class FrameBudget {
 public:
  explicit FrameBudget(double share) : share_(share) {}
  /// Whether there is time for a frame at this moment (seconds on any clock).
  bool allows(double now_s);
  void spend(double seconds) { saved_s_ -= seconds; }

 private:
  const double share_;
  double saved_s_ = 0, last_s_ = -1;
};

class WatchedTraining final : public WatchedScene {
 public:
  /// `scene` must outlive this. `stop`: asks the training to write a checkpoint and end.
  WatchedTraining(const TrainConfig& config, const Scene& scene, std::function<void()> stop);

  /// Adds the callbacks to those that `hooks` has. hooks.stop_signal, if set, also ends a pause.
  void attach(TrainHooks& hooks);
  /// Saves the model and returns the checkpoint: Trainer::save(). Called within TrainHooks::on_model.
  void set_save(std::function<std::filesystem::path()> save) { save_ = std::move(save); }

  /// The end of a training that has not failed; close() alone is that of one that has.
  void finish(const TrainResult& result);

  ViewState state(int since) const override;
  void command(ViewCommand command) override;
  bool is_stopped() const override { return stop_signal_ != nullptr && *stop_signal_ != 0; }
  void close() override;

 private:
  void note_progress(const TrainProgress& progress);
  bool wants_model();
  void show(const ModelInTraining& model);
  Frame paint(const FrameRequest& request, const ModelInTraining& model);
  void save_now();
  void set_notice(const std::string& notice, bool is_warning);

  const TrainConfig config_;
  const std::function<void()> stop_;
  std::function<std::filesystem::path()> save_;
  const std::atomic<int>* stop_signal_ = nullptr;
  FrameBudget budget_;
  std::atomic<bool> is_paused_{false}, is_to_save_{false};

  mutable std::mutex mutex_;  // of what follows
  ViewState state_;
  Eta eta_;
  int curve_spacing_ = 1;  // iterations between points of the curve
};

}  // namespace b3dgs
