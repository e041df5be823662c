// The live view of a training. Between two steps, the trainer's thread renders frames for the server's threads.
#pragma once

#include <atomic>
#include <functional>
#include <mutex>

#include "app/common/torch/progress.h"
#include "app/view/watched_scene.h"
#include "train/trainer.h"

namespace b3dgs {

/// Limits the share of the time that frames take, by when they begin and how large they are. A frame may begin when the
/// frames before it have been paid for. Time without frames saves up for a quarter of a second of them.
class FrameBudget {
 public:
  explicit FrameBudget(double share) : share_(share) {}
  /// Returns whether there is time for a frame now (seconds on any clock).
  bool allows(double now_s);
  /// Returns how many pixels a frame may have now. A draft, and the first frame, are small. Other frames use the
  /// savings except for a reserve, which pays for the drafts that follow the next click or drag.
  double pixels(bool is_draft) const;
  /// Returns the seconds until a frame that is not a draft may have this many pixels or, if that is less, as many as
  /// the largest savings pay for. `unpaid_s` will be spent before.
  double wait_s(double pixels, double unpaid_s = 0) const;
  /// Accounts for a frame that took `seconds`.
  void spend(double seconds) { saved_s_ -= seconds; }
  /// Learns from a frame how long a pixel takes.
  void learn(double seconds, double pixels, bool is_draft);

 private:
  static constexpr double kMostSavedSeconds = 0.25;
  const double share_;
  double saved_s_ = kMostSavedSeconds, last_s_ = -1;
  double pixel_s_ = 0, draft_pixel_s_ = 0;  // a draft's pixel takes longer, because part of the work is for any size
};

class WatchedTraining final : public WatchedScene {
 public:
  /// `scene` must outlive this. `stop` requests that the training write a checkpoint and end.
  WatchedTraining(const FinalConfig& config, const Scene& scene, std::function<void()> stop);

  /// Adds its callbacks to those in `hooks`. hooks.stop_signal, if set, also ends a pause.
  void attach(TrainHooks& hooks);
  /// Sets the function that saves the model and returns the checkpoint, Trainer::save(). It is called in
  /// TrainHooks::on_model.
  void set_save(std::function<std::filesystem::path()> save) { save_ = std::move(save); }

  /// Ends the view of a successful training. After a failed one, only close() is called.
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
  Frame paint_within_budget(const FrameRequest& request, const ModelInTraining& model);
  void save_now();
  void set_notice(const std::string& notice, bool is_warning);

  const TrainConfig config_;
  const std::function<void()> stop_;
  std::function<std::filesystem::path()> save_;
  const std::atomic<int>* stop_signal_ = nullptr;
  FrameBudget budget_;
  std::atomic<bool> is_paused_{false}, is_to_save_{false};

  mutable std::mutex mutex_;  // protects the following members
  ViewState state_;
  Eta eta_;
  int curve_spacing_ = 1;  // iterations between points of the curve
};

}  // namespace b3dgs
