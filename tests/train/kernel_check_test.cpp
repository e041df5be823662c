// Tests kernel checks within steps: the order of the blends, which of them are timed, and that training does not
// change.
#include "train/selection/kernel_check.h"

#include <gtest/gtest.h>

#include <fstream>
#include <map>

#include "support/temp_dir.h"
#include "support/train/tiny_scene.h"
#include "support/train/training.h"

namespace b3dgs {
namespace {

/// A simulated device on which each blend takes a given time.
struct InventedDevice {
  std::map<ForwardKernel, double> ms{{ForwardKernel::kSegmented, 2},
                                     {ForwardKernel::kSubTile, 1},
                                     {ForwardKernel::kCombined, 2},
                                     {ForwardKernel::kSharedMemory, 1}};
  double now_ms = 0;
  std::vector<ForwardKernel> blended;

  StageClock clock() {
    struct Mark final : StageMark {
      explicit Mark(double at) : at_ms(at) {}
      bool is_reached() const override { return true; }
      void wait() const override {}
      double ms_since(const StageMark& from) const override { return at_ms - dynamic_cast<const Mark&>(from).at_ms; }
      double at_ms;
    };
    return [this] { return std::make_unique<Mark>(now_ms); };
  }
  /// Blends a view as the rasterizer does.
  void blend(const RenderSettings& settings) {
    const auto run = [&](ForwardKernel kernel) {
      now_ms += ms.at(kernel);
      blended.push_back(kernel);
    };
    blended.clear();
    settings.run_blend != nullptr ? (*settings.run_blend)(run) : run(settings.kernel);
  }
};

using Kernels = std::vector<ForwardKernel>;
constexpr ForwardKernel kSegmented = ForwardKernel::kSegmented, kSubTile = ForwardKernel::kSubTile;

TEST(KernelCheck, BlendsWithBothInTurnAndEndsWithTheKernelInUse) {
  InventedDevice device;
  KernelCheck check(TrainConfig{}, "machine", device.clock());
  const auto blended = [&](int iteration) {
    device.blend(check.begin_view(iteration, {}));
    return device.blended;
  };
  const Kernels other_first{kSubTile, kSegmented}, other_last{kSegmented, kSubTile, kSegmented};
  EXPECT_EQ(blended(1), other_first) << "not counted: it loads the kernels";
  for (int i = 2; i <= 5; ++i) {
    for (int attempt = 0; attempt < 2; ++attempt) {  // a view whose step failed is passed again
      EXPECT_EQ(blended(i), i % 2 == 0 ? other_first : other_last) << i;
    }
  }
}

TEST(KernelCheck, DecidesAfterTheLastViewOfACheckAndKnowsItsCost) {
  InventedDevice device;
  KernelCheck check(TrainConfig{}, "machine", device.clock());
  for (int i = 1; i <= 5; ++i) {
    EXPECT_FALSE(check.decide(i)) << i;
    const double before_ms = device.now_ms;
    device.blend(check.begin_view(i, {}));
    if (i == 1) device.now_ms = before_ms;
  }
  const std::optional<KernelDecision> decision = check.decide(6);
  ASSERT_TRUE(decision);
  EXPECT_EQ(decision->views, KernelSelector::kViews - 1) << "the first launch of a kernel loads it";
  EXPECT_EQ(decision->times_ms.at("segmented"), 2);
  EXPECT_EQ(decision->times_ms.at("sub-tile"), 1);
  EXPECT_EQ(decision->cost_ms, device.now_ms - 4 * 2) << "four views would have taken 2 ms each";
  EXPECT_EQ(check.kernel(), "sub-tile");
  EXPECT_FALSE(check.decide(7));
  EXPECT_EQ(check.begin_view(6, {}).run_blend, nullptr);
  device.blend(check.begin_view(6, {}));
  EXPECT_EQ(device.blended, Kernels{kSubTile});
  for (int i = 1001; i <= 1005; ++i) device.blend(check.begin_view(i, {}));
  EXPECT_EQ(check.decide(1006)->views, KernelSelector::kViews);
}

TEST(KernelCheck, CountsAViewThatFailedOnce) {
  InventedDevice device;
  KernelCheck check(TrainConfig{}, "machine", device.clock());
  for (const int i : {1, 2, 2, 3, 4, 4, 4}) device.blend(check.begin_view(i, {}));
  EXPECT_EQ(check.decide(2000)->views, 3);
}

TEST(KernelCheck, PublishedHasThePapersPair) {
  InventedDevice device;
  TrainConfig config;
  config.kernel = kPublishedKernel;
  config.kernel_check_interval = 10;
  KernelCheck check(config, "machine", device.clock());
  for (int i = 1; i <= 20; ++i) {
    check.decide(i);
    EXPECT_EQ(check.kernel(), i <= 15 ? "combined" : "shared-memory") << i;
    device.blend(check.begin_view(i, {}));
  }
}

TEST(KernelCheck, AFixedKernelIsNotTimed) {
  InventedDevice device;
  TrainConfig config;
  config.kernel = "naive";
  KernelCheck check(config, "machine", device.clock());
  const RenderSettings settings = check.begin_view(1, {});
  EXPECT_EQ(settings.kernel, ForwardKernel::kNaive);
  EXPECT_EQ(settings.run_blend, nullptr);
  EXPECT_FALSE(check.decide(2000));
}

TEST(KernelCheck, DeterministicTrainingIsTimedButKeepsTheStandardKernel) {
  InventedDevice device;
  device.ms[kSubTile] = 10;
  TrainConfig config;
  config.deterministic = true;
  KernelCheck check(config, "machine", device.clock());
  for (int i = 1; i <= 2; ++i) device.blend(check.begin_view(i, {}));
  EXPECT_EQ(check.decide(3)->times_ms.at("sub-tile"), 10);
  EXPECT_EQ(check.kernel(), "sub-tile");
}

/// Returns a config of twenty iterations with checks in 1 to 5 and 11 to 15.
TrainConfig checked_config() {
  TrainConfig config = test::eventful_config();
  config.kernel = kAdaptive;
  config.kernel_check_interval = 10;
  return config;
}

/// Returns the lines of checks in train.jsonl.
std::vector<nlohmann::json> checks_of(const std::filesystem::path& folder) {
  std::vector<nlohmann::json> lines;
  std::ifstream file(folder / "train.jsonl");
  for (std::string line; std::getline(file, line);) {
    const nlohmann::json json = nlohmann::json::parse(line);
    if (json.value("event", "") == "kernel_check") lines.push_back(json);
  }
  return lines;
}

TEST(TrainingWithKernelChecks, LearnsTheSameAndLogsEveryCheckToTheEnd) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  const test::Trained plain = test::train(test::eventful_config(), scene, temp / "plain");
  const test::Trained checked = test::train(checked_config(), scene, temp / "checked");
  EXPECT_TRUE(test::same(checked.ply, plain.ply)) << "on a CPU, both kernels give the same bits";
  EXPECT_TRUE(checks_of(temp / "plain").empty());
  const std::vector<nlohmann::json> checks = checks_of(temp / "checked");
  ASSERT_EQ(checks.size(), 2u);
  EXPECT_EQ(checks[0].at("iteration"), 6);
  EXPECT_EQ(checks[1].at("iteration"), 16);
  EXPECT_EQ(checks[1].at("before"), checks[0].at("after"));
  for (const nlohmann::json& check : checks) {
    EXPECT_EQ(check.at("times_ms").size(), 2u);
    EXPECT_GT(check.at("cost_ms"), 0);
  }
}

TEST(TrainingWithKernelChecks, LogsTheCheckThatTheEndCutsShort) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = checked_config();
  config.iterations = 14;
  config.batch = 3;  // a step may begin in a check and end after it
  test::train(config, scene, temp.path());
  const std::vector<nlohmann::json> checks = checks_of(temp.path());
  ASSERT_EQ(checks.size(), 2u);
  EXPECT_EQ(checks[1].at("views"), 4);
  EXPECT_EQ(checks[1].at("iteration"), 15);
}

/// Returns hooks with a clock on which sub-tile takes `sub_tile_ms` ms and segmented, with which training starts, 2 ms.
/// Each view takes three marks. The first view is not counted, and then the order of the kernels alternates.
TrainHooks with_times(InventedDevice& device, double sub_tile_ms) {
  TrainHooks hooks;
  hooks.kernel_clock = [&device, sub_tile_ms, clock = device.clock(), n = 0]() mutable {
    const double steps[]{0, sub_tile_ms, 2, 0, 2, sub_tile_ms};
    device.now_ms += steps[n < 3 ? n : (n - 3) % 6];
    ++n;
    return clock();
  };
  return hooks;
}

TEST(TrainingWithKernelChecks, KeepsTheChoiceWhenItIsResumed) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  InventedDevice device;
  TrainConfig config = checked_config();
  config.iterations = 10;
  const test::Trained first = test::train(config, scene, temp.path(), {}, with_times(device, 1));
  ASSERT_EQ(checks_of(temp.path()).at(0).at("after"), "sub-tile");
  config.iterations = 20;
  test::train(config, scene, temp.path(), first.result.checkpoint);
  EXPECT_EQ(checks_of(temp.path()).at(1).at("before"), "sub-tile");
}

// The list of the scene's only tile is long enough for segmented to cut the tile.
TEST(TrainingWithKernelChecks, TheChoiceChangesNoByteOnACpu) {
  test::TinySceneOptions options;
  options.n_gaussians = 9000;
  options.n_views = 6;
  options.width = options.height = 16;
  options.log_scale = -3.5f;
  const Scene scene = test::make_tiny_scene(options);
  const test::TempDir temp;
  TrainConfig config = checked_config();
  config.init_opacity = 0.006;  // low enough that light passes through the whole list
  config.kernel_check_interval = 8;
  config.iterations = 12;
  InventedDevice device;
  const std::string switched = test::train(config, scene, temp / "switched", {}, with_times(device, 1)).ply;
  EXPECT_EQ(checks_of(temp / "switched").at(0).at("after"), "sub-tile");
  EXPECT_TRUE(test::same(test::train(config, scene, temp / "kept", {}, with_times(device, 3)).ply, switched));
  EXPECT_EQ(checks_of(temp / "kept").at(0).at("after"), "segmented");
}

}  // namespace
}  // namespace b3dgs
