#include "train/timing/timers.h"

#include <gtest/gtest.h>

#include <fstream>
#include <map>
#include <set>

#include "support/same.h"
#include "support/temp_dir.h"
#include "support/train/tiny_scene.h"
#include "support/train/training.h"
#include "train/density/strategies/strategies.h"

namespace b3dgs {
namespace {

/// A simulated device with a time that the test sets. It has finished its queue up to `done_ms`.
struct HandClock {
  double now_ms = 0;
  double done_ms = 1e9;
  int n_marks = 0, n_kept = 0;
};

class HandMark final : public StageMark {
 public:
  explicit HandMark(HandClock& clock) : clock_(clock), ms_(clock.now_ms) {
    ++clock.n_marks;
    ++clock.n_kept;
  }
  ~HandMark() override { --clock_.n_kept; }
  bool is_reached() const override { return ms_ <= clock_.done_ms; }
  void wait() const override { clock_.done_ms = std::max(clock_.done_ms, ms_); }
  double ms_since(const StageMark& from) const override { return ms_ - static_cast<const HandMark&>(from).ms_; }

 private:
  HandClock& clock_;
  const double ms_;
};

double ms_of(const StageTimes& times, Stage stage) {
  return times.ms[static_cast<std::size_t>(stage)].value_or(-1);
}

class StageTimerTest : public testing::Test {
 protected:
  /// Simulates a step that projects for `project_ms` and optimises in two parts of 2 ms, with 1 ms of idle time before,
  /// between and after.
  void run_step(double project_ms) {
    timer.start(StageTimes::Kind::kStep);
    clock.now_ms += 1;
    timer.begin(Stage::kOptimizer);
    clock.now_ms += 2;
    timer.begin(Stage::kProject);
    clock.now_ms += project_ms;
    timer.end();
    clock.now_ms += 1;
    timer.begin(Stage::kOptimizer);
    clock.now_ms += 2;
    timer.end();
    clock.now_ms += 1;
    timer.finish();
  }
  void run_round(double ms) {
    timer.start(StageTimes::Kind::kDensityRound);
    clock.now_ms += ms;
    timer.finish();
  }

  HandClock clock;
  StageTimer timer{[this] { return std::make_unique<HandMark>(clock); }};
};

TEST_F(StageTimerTest, AddsUpStagesAndLeavesTheRestToTheHost) {
  run_step(5);
  const std::vector<StageTimes> known = timer.take();
  ASSERT_EQ(known.size(), 1u);
  EXPECT_EQ(ms_of(known[0], Stage::kProject), 5);
  EXPECT_EQ(ms_of(known[0], Stage::kOptimizer), 4);
  EXPECT_EQ(ms_of(known[0], Stage::kLoss), -1) << "there was none";
  EXPECT_EQ(known[0].wall_ms, 12);
  EXPECT_EQ(known[0].host_ms(), 3);
  EXPECT_EQ(stage_json(known[0]).dump(), R"({"project":5.0,"optimizer":4.0,"host":3.0})");
  EXPECT_TRUE(timer.take().empty()) << "told twice";
  EXPECT_EQ(clock.n_kept, 0) << "marks are kept";
}

TEST_F(StageTimerTest, TellsWhatTheDeviceHasGotThrough) {
  clock.done_ms = 15;
  run_step(5);  // until 12
  run_step(5);  // until 24
  run_step(7);
  EXPECT_EQ(timer.take().size(), 1u);
  clock.done_ms = 24;
  EXPECT_EQ(timer.take().size(), 1u);
  EXPECT_TRUE(timer.take().empty());
  const std::vector<StageTimes> last = timer.wait();
  ASSERT_EQ(last.size(), 1u);
  EXPECT_EQ(ms_of(last[0], Stage::kProject), 7);
}

TEST_F(StageTimerTest, TakesNoMarksOutsideOfASample) {
  timer.begin(Stage::kProject);
  timer.begin(Stage::kBin);
  timer.end();
  timer.finish();
  EXPECT_EQ(clock.n_marks, 0);
  EXPECT_TRUE(timer.wait().empty());
}

TEST_F(StageTimerTest, SharesRoundsOfDensityControlOutAmongAllSteps) {
  StageAverage average;
  run_round(50);
  for (const StageTimes& times : timer.take()) average.add(times);
  EXPECT_FALSE(average.take(100)) << "no step was timed";
  run_step(5);
  run_step(7);
  for (const StageTimes& times : timer.take()) average.add(times);
  const std::optional<StageTimes> mean = average.take(200);
  ASSERT_TRUE(mean);
  EXPECT_DOUBLE_EQ(ms_of(*mean, Stage::kProject), 6);
  EXPECT_DOUBLE_EQ(ms_of(*mean, Stage::kOptimizer), 4);
  EXPECT_DOUBLE_EQ(ms_of(*mean, Stage::kDensify), 0.25);
  EXPECT_DOUBLE_EQ(mean->host_ms(), 3);
  EXPECT_FALSE(average.take(1)) << "taken twice";
}

void expect_sound(const StageTimes& times) {
  double sum = 0;
  for (std::size_t i = 0; i < kStageCount; ++i) {
    ASSERT_TRUE(times.ms[i]) << kStageNames[i];
    EXPECT_GE(*times.ms[i], 0) << kStageNames[i];
    sum += *times.ms[i];
  }
  EXPECT_LE(sum, times.wall_ms * (1 + 1e-9));
  EXPECT_GT(ms_of(times, Stage::kBlendForward), 0);
  EXPECT_NEAR(sum + times.host_ms(), times.wall_ms, 1e-9);
}

TEST(StagesOfTraining, AreAllThereInEveryStepIfAskedFor) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  const TrainConfig config = test::eventful_config();
  int n_steps = 0, n_rounds = 0, n_planned = 0;
  const std::unique_ptr<DensityStrategy> strategy = make_density_strategy(config, 1);
  for (int i = 1; i <= config.iterations; ++i) n_planned += strategy->plan(i).densify;
  TrainHooks hooks;
  hooks.on_stage_times = [&](const StageTimes& times) {
    if (times.kind == StageTimes::Kind::kDensityRound) {
      ++n_rounds;
      EXPECT_GT(times.wall_ms, 0);
    } else {
      ++n_steps;
      expect_sound(times);
    }
  };
  Trainer trainer(finalize(config, scene), scene, ModelFolder(temp.path()), hooks);
  const TrainResult result = trainer.run();
  trainer.wait();
  EXPECT_EQ(n_steps, config.iterations);
  EXPECT_EQ(n_rounds, n_planned);
  EXPECT_GT(n_rounds, 0);
  Trainer untimed(finalize(config, scene), scene, ModelFolder(temp / "untimed"), {});
  EXPECT_TRUE(test::same(test::read_bytes(untimed.run().ply), test::read_bytes(result.ply)))
      << "timing changes the model";
}

TEST(StagesOfTraining, AreLoggedOncePerHundredSteps) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = test::eventful_config();
  config.iterations = 160;
  test::train(config, scene, temp.path());
  std::set<int> logged;
  std::ifstream file(temp / "train.jsonl");
  for (std::string line; std::getline(file, line);) {
    const nlohmann::json json = nlohmann::json::parse(line);
    if (!json.contains("stages_ms")) continue;
    logged.insert(json["iteration"].get<int>());
    for (const char* name : kStageNames) EXPECT_GE(json["stages_ms"].at(name).get<double>(), 0) << name;
    EXPECT_GE(json["stages_ms"].at("host").get<double>(), 0);
    EXPECT_EQ(json["stages_ms"].size(), kStageCount + 1);
  }
  EXPECT_EQ(logged, (std::set<int>{50, 150}));
}

TEST(StagesOfTraining, CanBeWalkedThroughStepByStepWithoutFiles) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  const TrainConfig config = test::eventful_config();
  int n_steps = 0;
  TrainHooks hooks;
  hooks.on_stage_times = [&](const StageTimes& times) { n_steps += times.kind == StageTimes::Kind::kStep; };
  Trainer trainer(finalize(config, scene), scene, ModelFolder(temp / "model"), hooks);
  for (int i = 0; i < 12; ++i) trainer.step();
  trainer.wait();
  EXPECT_EQ(n_steps, 12);
  EXPECT_GT(trainer.n_gaussians(), 120) << "density control at 10";
  EXPECT_FALSE(std::filesystem::exists(temp / "model"));
}

}  // namespace
}  // namespace b3dgs
