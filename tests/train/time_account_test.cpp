// Tests which time counts as training time, on a simulated device that finishes work later than it is queued, and in a
// training with a simulated clock.
#include "train/timing/timers.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <map>

#include "support/temp_dir.h"
#include "support/train/tiny_scene.h"
#include "support/train/training.h"

namespace b3dgs {
namespace {

/// Simulated time of host and device in seconds.
struct InventedDevice {
  double now_s = 0, busy_until_s = 0;

  void queue(double seconds) { busy_until_s = std::max(busy_until_s, now_s) + seconds; }
  void wait() { now_s = std::max(now_s, busy_until_s); }
  TimeAccount account() {
    return {[this] { return now_s; }, [this] { wait(); }};
  }
};

TEST(TimeAccount, TrainsWithoutWaitingForTheDevice) {
  InventedDevice device;
  TimeAccount time = device.account();
  time.train([&] { device.queue(8); });
  EXPECT_EQ(device.now_s, 0);
  time.train([&] { device.now_s += 3; });
  time.finish_training();
  EXPECT_EQ(device.now_s, 8);
  EXPECT_EQ(time.train_s(), 8) << "the host's 3 s lie within the device's 8";
  EXPECT_EQ(time.output_s(), 0);
}

TEST(TimeAccount, EachKindPaysForItsOwnWorkOfTheDevice) {
  InventedDevice device;
  TimeAccount time = device.account();
  time.train([&] { device.queue(8); });
  time.output([&] {
    EXPECT_EQ(device.now_s, 8) << "the training is not done";
    device.now_s += 1;
    device.queue(100);
  });
  EXPECT_EQ(device.now_s, 109) << "the output is not done";
  time.train([&] { device.queue(16); });
  time.finish_training();
  EXPECT_EQ(time.train_s(), 24);
  EXPECT_EQ(time.output_s(), 101);
}

TEST(TrainingTime, HoldsDensificationButNoOutput) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = test::eventful_config();
  config.test_iterations = {7, 10};
  config.save_iterations = {8, 10};
  config.checkpoint_iterations = {9, 10};
  // Each activity takes the time given here, and nothing else takes any time, so sums show where it was counted.
  const std::map<std::string, double> seconds{{"training", 0}, {"densifying", 1e2}, {"evaluating", 1e4},
                                              {"saving", 1e6}, {"checkpoint", 1e8}, {"counting floaters", 1e12}};
  double now_s = 0;
  std::map<std::string, int> count;
  TrainHooks hooks;
  hooks.clock_s = [&] { return now_s; };
  hooks.on_progress = [&](const TrainProgress& progress) {
    now_s += seconds.at(progress.activity);
    ++count[progress.activity];
  };
  const TrainResult result = Trainer(finalize(config, scene), scene, ModelFolder(temp.path()), hooks).run();
  EXPECT_EQ(count["training"], 20);
  EXPECT_EQ(count["densifying"], 3);  // 10, 15, 20
  EXPECT_EQ(count["evaluating"], 3);
  EXPECT_EQ(count["counting floaters"], 1);
  EXPECT_EQ(count["saving"], 3);
  EXPECT_EQ(count["checkpoint"], 3);
  EXPECT_EQ(result.train_s, 3e2);
  EXPECT_EQ(result.output_s, 3e4 + 3e6 + 3e8 + 1e12);
}

TEST(TrainingTime, HoldsTheSteps) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  const Trainer* running = nullptr;
  TrainHooks hooks;
  hooks.clock_s = [&] { return running != nullptr ? running->iteration() : 0.0; };  // a step takes a second
  Trainer trainer(finalize(test::eventful_config(), scene), scene, ModelFolder(temp.path()), hooks);
  running = &trainer;
  const TrainResult before = trainer.run(1);
  const TrainResult after = trainer.run(19);  // nothing is measured or saved until then
  EXPECT_EQ(before.train_s, 1);
  EXPECT_EQ(after.train_s, 19);
  EXPECT_EQ(after.output_s, 0);
}

}  // namespace
}  // namespace b3dgs
