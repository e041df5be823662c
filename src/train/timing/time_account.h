// Splits the time of a session into training and output (evaluating and saving). Work on a GPU ends some time after the
// call that queued it, so the device is waited for wherever one kind of work follows the other.
#pragma once

#include <functional>
#include <utility>

namespace b3dgs {

class TimeAccount {
 public:
  /// `clock_s` returns seconds; `wait_for_device` returns when the device has finished all queued work.
  TimeAccount(std::function<double()> clock_s, std::function<void()> wait_for_device)
      : clock_s_(std::move(clock_s)), wait_for_device_(std::move(wait_for_device)) {}

  /// Counts the duration of `work` as training. Does not wait for the device: work that it queues there is counted when
  /// a later piece of training waits for it.
  template <class Work>
  void train(Work&& work) {
    count(train_s_, std::forward<Work>(work));
    is_idle_ = false;
  }

  /// Counts the duration of `work` as output, from when the device has finished training until it has finished `work`.
  template <class Work>
  void output(Work&& work) {
    finish_training();
    count(output_s_, [&] {
      work();
      wait_for_device_();
    });
  }

  /// Waits until the device has finished training, and counts that as training.
  void finish_training() {
    if (is_idle_) return;
    count(train_s_, wait_for_device_);
    is_idle_ = true;
  }

  double train_s() const { return train_s_; }
  double output_s() const { return output_s_; }

 private:
  template <class Work>
  void count(double& sum_s, Work&& work) {
    const double start_s = clock_s_();
    work();
    sum_s += clock_s_() - start_s;
  }

  std::function<double()> clock_s_;
  std::function<void()> wait_for_device_;
  double train_s_ = 0, output_s_ = 0;
  bool is_idle_ = true;  // the device
};

}  // namespace b3dgs
