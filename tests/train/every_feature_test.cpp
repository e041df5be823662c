// Tests with every feature: a training that was interrupted, or has another number of threads, writes the same files.
#include "support/train/every_feature.h"

#include <gtest/gtest.h>

#include <functional>
#include <utility>
#include <vector>

#include "support/same.h"
#include "support/temp_dir.h"
#include "support/train/short_memory.h"
#include "train/checkpoint/checkpoint.h"
#include "train/density/strategies/strategies.h"

namespace b3dgs {
namespace {

using test::train;
using test::Trained;

class EveryFeature : public testing::TestWithParam<test::FeatureRow> {
 protected:
  const test::TempDir temp;
  const Scene scene = test::FeatureScene(temp / "depths").scene;
  TrainConfig config = test::every_feature(GetParam(), temp / "depths");
};

TEST_P(EveryFeature, ResumedEqualsUninterruptedBitForBitOnAnyNumberOfThreads) {
  if (config.strategy == Strategy::kBudget) {
    const std::unique_ptr<DensityStrategy> strategy = make_density_strategy(config, 1);
    ASSERT_TRUE(strategy->plan(13).score && strategy->plan(14).score);
  }
  const Trained whole = test::expect_exact_resume_from_checkpoints(config, scene, temp.path());
  EXPECT_NE(whole.result.n_gaussians, static_cast<std::int64_t>(scene.points.size())) << "no density control happened";
  const nlohmann::ordered_json header = read_checkpoint_header(whole.result.checkpoint);
  EXPECT_EQ(header.at("adam_steps"), config.iterations) << "counts views";
  EXPECT_EQ(header.at("appearance_steps"), config.iterations);
  for (const int threads : {1, 3}) {
    config.threads = threads;
    EXPECT_TRUE(test::same(train(config, scene, temp / "again").ply, whole.ply)) << threads << " threads";
  }
}

/// If memory is short before a step changes the Gaussians, the step is taken again as if nothing had happened. Nothing
/// is allocated after that.
TEST_P(EveryFeature, AStepThatRunsOutOfMemoryIsRepeated) {
  config.checkpoint_iterations = {};
  const Trained whole = train(config, scene, temp / "whole");
  int n_failed = 0;
  bool has_failed = true;
  for (std::int64_t n = config.batch - 1; has_failed; n += 2) {
    SCOPED_TRACE(testing::Message() << "allocation " << n << " of each step");
    test::FailOnce failure;
    const test::FailingAllocator allocator([&](std::size_t) { return failure(); });
    TrainHooks hooks;
    hooks.wants_model = [&] {  // after density control
      failure.n = n;
      return false;
    };
    hooks.on_progress = [&](const TrainProgress&) { failure.n = -1; };  // after the step
    const Trained run = train(config, scene, temp / "short", {}, hooks);
    ASSERT_TRUE(test::same(run.checkpoint, whole.checkpoint));
    has_failed = failure.has_failed;
    n_failed += has_failed ? 1 : 0;
  }
  EXPECT_GE(n_failed, 3);
}

INSTANTIATE_TEST_SUITE_P(Rows, EveryFeature, testing::ValuesIn(test::kFeatureRows),
                         [](const auto& info) { return info.param.name(); });

/// Tests that each feature has an effect, because the tests above prove nothing about a feature without one.
TEST(Features, MakeADifference) {
  const std::vector<std::pair<const char*, void (*)(TrainConfig&)>> without{
      {"exposures or grid", [](TrainConfig& c) { c.exposure = c.bilateral_grid = false; }},
      {"poses", [](TrainConfig& c) { c.pose_opt = false; }},
      {"anti-aliasing", [](TrainConfig& c) { c.antialiasing = false; }},
      {"depths", [](TrainConfig& c) { c.depths.clear(); }},
      {"opacity_reg", [](TrainConfig& c) { c.opacity_reg = 0; }},
      {"scale_reg", [](TrainConfig& c) { c.scale_reg = 0; }},
      {"coarse", [](TrainConfig& c) { c.coarse_scale = 1; }},
      {"background", [](TrainConfig& c) { c.random_background = false; }},
      {"seed", [](TrainConfig& c) { ++c.seed; }}};
  const test::TempDir temp;
  const Scene scene = test::FeatureScene(temp / "depths").scene;
  for (const test::FeatureRow& row : {test::kFeatureRows[1], test::kFeatureRows[2]}) {
    SCOPED_TRACE(row.name());
    const TrainConfig config = test::every_feature(row, temp / "depths");
    const std::string with = train(config, scene, temp / "with").ply;
    for (const auto& [what, turn_off] : without) {
      TrainConfig changed = config;
      turn_off(changed);
      EXPECT_FALSE(train(changed, scene, temp / "without").ply == with) << what;
    }
    if (config.strategy == Strategy::kBudget) {
      TrainConfig whole = config;
      whole.crop.clear();
      EXPECT_FALSE(train(whole, scene, temp / "without").ply == with) << "crop";
    }
    if (config.strategy != Strategy::kMcmc) continue;
    TrainConfig still = config;
    still.noise_lr = 0;
    EXPECT_FALSE(train(still, scene, temp / "without").ply == with) << "noise";
  }
}

}  // namespace
}  // namespace b3dgs
