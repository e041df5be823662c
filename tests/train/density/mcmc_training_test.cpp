// Tests trainings with strategy mcmc, and with regularisation.

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "support/approx.h"
#include "support/same.h"
#include "support/temp_dir.h"
#include "support/train/short_memory.h"
#include "support/train/tiny_scene.h"
#include "support/train/training.h"
#include "train/checkpoint/checkpoint.h"
#include "train/trainer.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

using test::train;
using test::Trained;

/// Returns a config with rounds at 10, 15 and 20, each of which moves some of the 120 Gaussians and adds a twentieth,
/// up to 130.
TrainConfig mcmc_config() {
  TrainConfig config = test::eventful_config();
  config.strategy = Strategy::kMcmc;
  config.opacity_lr = 0.05;
  config.opacity_reg = 0.01;
  config.scale_reg = 0.01;
  config.init_opacity = 0.5;
  config.prune_opacity = 0.45;
  config.max_gaussians = 130;
  return config;
}

TEST(McmcTraining, GrowsToTheLimit) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  Trainer trainer(finalize(mcmc_config(), scene), scene, ModelFolder(temp / "model"), {});
  std::vector<std::int64_t> counts;
  for (const int until : {9, 10, 14, 15, 19, 20}) {
    trainer.run(until);
    counts.push_back(trainer.n_gaussians());
  }
  EXPECT_EQ(counts, (std::vector<std::int64_t>{120, 126, 126, 130, 130, 130}));
}

TEST(McmcTraining, NeedsALimitOnACpu) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = mcmc_config();
  config.max_gaussians = 0;
  try {
    Trainer(finalize(config, scene), scene, ModelFolder(temp / "model"), {});
    FAIL() << "accepted";
  } catch (const InputError& error) {
    EXPECT_NE(std::string(error.what()).find("--max_gaussians 0: expected a limit on a CPU"), std::string::npos)
        << error.what();
  }
}

TEST(McmcTraining, StartsAboveTheLimitWithoutGrowing) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = mcmc_config();
  config.max_gaussians = 100;
  EXPECT_EQ(train(config, scene, temp / "model").result.n_gaussians, 120);
}

/// Trains with this memory. Returns the number of Gaussians, and the number at which it was capped (0: not capped).
std::pair<std::int64_t, std::int64_t> counts_with(const std::shared_ptr<test::ShortMemory>& memory,
                                                  const fs::path& folder) {
  const Scene scene = test::make_tiny_scene();
  TrainHooks hooks;
  hooks.memory = memory;
  const TrainResult result = Trainer(finalize(mcmc_config(), scene), scene, ModelFolder(folder), hooks).run();
  return {result.n_gaussians, read_checkpoint_header(result.checkpoint).at("count_cap").get<std::int64_t>()};
}

TEST(McmcTraining, CapsTheCountOnlyWhereMemoryIsShort) {
  const test::TempDir temp;
  auto memory = std::make_shared<test::ShortMemory>();
  memory->bytes = std::int64_t{1} << 30;
  EXPECT_EQ(counts_with(memory, temp / "ample"), (std::pair<std::int64_t, std::int64_t>{130, 0}))
      << "--max_gaussians is no lack of memory";
  memory->bytes = 130000;
  const auto [count, count_cap] = counts_with(memory, temp / "short");
  EXPECT_GE(count_cap, 120);
  EXPECT_LT(count_cap, 130);
  EXPECT_EQ(count, count_cap);
  memory->bytes.reset();
  memory->rows_that_fit = 125;  // an allocation for more fails
  EXPECT_EQ(counts_with(memory, temp / "failing"), (std::pair<std::int64_t, std::int64_t>{120, 120}));
}

TEST(McmcTraining, CanTakeOverFromAnotherStrategyAndBack) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = mcmc_config();
  config.strategy = Strategy::kDefault;
  config.iterations = 8;
  const fs::path first = train(config, scene, temp / "model").result.checkpoint;
  config.strategy = Strategy::kMcmc;
  config.iterations = 18;
  Trainer trainer(finalize(config, scene), scene, ModelFolder(temp / "model"), {});
  EXPECT_EQ(trainer.resume(first),
            (std::vector<std::string>{"iterations: 8 -> 18", "strategy: \"default\" -> \"mcmc\""}));
  const fs::path second = trainer.run().checkpoint;
  EXPECT_EQ(trainer.n_gaussians(), 130);
  config.strategy = Strategy::kDefault;
  config.iterations = 19;
  EXPECT_EQ(train(config, scene, temp / "model", second).result.iteration, 19);
}

TEST(McmcTraining, ReadsCheckpointsFromBeforeTheOption) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = test::eventful_config();
  config.iterations = 6;
  const fs::path checkpoint = train(config, scene, temp / "model").result.checkpoint;
  CheckpointFile file = read_checkpoint_file(checkpoint);
  for (const char* key : {"strategy", "opacity_reg", "scale_reg", "max_gaussians"}) {
    ASSERT_EQ(file.header["config"].erase(key), 1u) << key;
  }
  write_checkpoint_file(temp / "old.ckpt", file);
  config.iterations = 12;
  const Trained expected = train(config, scene, temp / "a", checkpoint);
  EXPECT_TRUE(test::same(train(config, scene, temp / "b", temp / "old.ckpt").ply, expected.ply));
}

TEST(Regularization, MakesGaussiansMoreTransparentAndSmaller) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = test::eventful_config();
  config.densify_from_iter = 1000;  // no density control
  const auto means_after = [&](const char* name) {
    const fs::path checkpoint = train(config, scene, temp / name).result.checkpoint;
    const GaussianTensors g = read_checkpoint(checkpoint, scene, torch::kCPU).state.gaussians;
    return std::pair(torch::sigmoid(g.logit_opacities).mean().item<double>(), g.log_scales.exp().mean().item<double>());
  };
  const auto [opacity, scale] = means_after("none");
  config.opacity_reg = 10;
  const auto [low_opacity, same_scale] = means_after("opacity");
  EXPECT_LT(low_opacity, 0.8 * opacity);
  EXPECT_NEAR(same_scale, scale, 0.1 * scale);
  config.opacity_reg = 0;
  config.scale_reg = 10;
  const auto [same_opacity, low_scale] = means_after("scale");
  EXPECT_LT(low_scale, 0.95 * scale);
  EXPECT_NEAR(same_opacity, opacity, 0.1 * opacity);
}

}  // namespace
}  // namespace b3dgs
