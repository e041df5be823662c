// Kernel checks on a tiny scene with a timer that returns made-up times, and the comparison of kernels' results.
#include "train/selection/kernel_chooser.h"

#include <gtest/gtest.h>
#include <torch/types.h>

#include <limits>
#include <set>

#include "core/check.h"
#include "support/approx.h"
#include "support/expect_error.h"
#include "support/same.h"
#include "support/temp_dir.h"
#include "support/train/tiny_scene.h"
#include "support/train/training.h"

namespace b3dgs {
namespace {

/// Does the work, and returns the given times for the kernel in use and the other one.
RunTimer invented_times(double in_use_ms, double other_ms) {
  return [=, n_views = 0](const std::vector<std::function<void()>>& runs) mutable {
    for (const std::function<void()>& run : runs) run();
    if (runs.size() != 2) return std::vector<double>(runs.size());
    const bool is_swapped = n_views++ % 2 == 1;  // the order alternates
    return is_swapped ? std::vector<double>{other_ms, in_use_ms} : std::vector<double>{in_use_ms, other_ms};
  };
}

/// All kernels compute the same, except for some that each compute something different.
BlendPass wrong_blend(const std::set<std::string>& wrong, const std::vector<std::string>& all) {
  const auto run = [=](const std::string& kernel) {
    const auto place = std::find(all.begin(), all.end(), kernel) - all.begin();
    return BlendPass::Result{torch::full({1}, wrong.count(kernel) > 0 ? 1.0 + static_cast<double>(place) : 0.0)};
  };
  return {[](const CameraView&) {}, run,
          [](const BlendPass::Result& result, const BlendPass::Result& kept) {
            return std::string(torch::equal(result[0], kept[0]) ? "" : "its image differs");
          }};
}

/// Before a step; its duration is not known unless given.
CheckMoment at(int iteration, double step_ms = 0) {
  return {iteration, step_ms};
}

class KernelChooserTest : public testing::Test {
 protected:
  void SetUp() override {
    for (const View& view : scene.train) cameras.push_back(to_camera_view(view.camera));
    ASSERT_GE(cameras.size(), 5u);
    cameras.resize(5);
  }
  BlendInput input() { return input_of(gaussians); }
  BlendInput input_of(const GaussianTensors& model) {
    const auto render = [this, model](const CameraView& view, const RenderSettings& settings) {
      return rasterizer.forward(model, view, settings);
    };
    return {rasterizer, render, {}, cameras};
  }
  KernelChooser chooser(double in_use_ms, double other_ms) {
    return KernelChooser(config, torch::kCPU, invented_times(in_use_ms, other_ms));
  }
  /// Like chooser(), but some kernels compute something different.
  KernelChooser chooser_with_wrong(const std::set<std::string>& kernels, double in_use_ms, double other_ms) {
    return KernelChooser(config, torch::kCPU, invented_times(in_use_ms, other_ms),
                         [=, all = config.kernel_candidates](const BlendInput&) { return wrong_blend(kernels, all); });
  }

  const Scene scene = test::make_tiny_scene();
  const GaussianTensors gaussians = to_tensors(splats_from_points(scene.points, 0), 0, torch::kCPU);
  TrainConfig config;
  Rasterizer rasterizer{torch::kCPU};
  std::vector<CameraView> cameras;
};

TEST(RunTimer, GivesATimeForEachRun) {
  int n_done = 0;
  const std::vector<double> ms = make_run_timer(torch::kCPU)({3, [&] { ++n_done; }});
  EXPECT_EQ(n_done, 3);
  ASSERT_EQ(ms.size(), 3u);
  for (const double each : ms) EXPECT_GE(each, 0);
  EXPECT_TRUE(make_run_timer(torch::kCPU)({}).empty());
}

TEST_F(KernelChooserTest, SwitchesToTheFasterKernel) {
  KernelChooser own = chooser(2.0, 1.0);
  EXPECT_EQ(own.apply({}).kernel, ForwardKernel::kSegmented);
  ASSERT_TRUE(own.is_due(at(1)));
  const std::vector<KernelDecision> done = own.check(at(1), input());
  ASSERT_EQ(done.size(), 1u) << "the CPU has only one backward kernel";
  EXPECT_EQ(done[0].pass, "forward");
  EXPECT_EQ(done[0].views, 3) << "three are enough to find a factor of two";
  EXPECT_EQ(done[0].times_ms.at("segmented"), 2.0);
  EXPECT_EQ(done[0].times_ms.at("shared-memory"), 1.0);
  EXPECT_EQ(done[0].message, "iteration 1: segmented 2 ms, shared-memory 1 ms: using shared-memory, permanently");
  EXPECT_EQ(own.apply({}).kernel, ForwardKernel::kSharedMemory);
  EXPECT_EQ(own.forward_name(), "shared-memory");
  EXPECT_EQ(own.backward_name(), "");
  EXPECT_FALSE(own.is_due(at(1000, 1e6)));
}

/// A GPU that is full is no reason to end a training, least of all for a check.
TEST_F(KernelChooserTest, FreesMemoryOrDecidesNothing) {
  int n_failures = 0, n_freed = 0;
  BlendInput full = input();
  full.render = [&](const PinholeView& view, const RenderSettings& settings) {
    if (n_failures-- > 0) throw OutOfMemoryError("no memory");
    return rasterizer.forward(gaussians, view, settings);
  };
  full.remedies = {[&] { return ++n_freed > 0; }};

  KernelChooser own = chooser(2.0, 1.0);
  n_failures = 1;
  EXPECT_EQ(own.check(at(1), full).front().times_ms.at("shared-memory"), 1.0);
  EXPECT_EQ(own.forward_name(), "shared-memory");
  EXPECT_EQ(n_freed, 1);
  n_failures = 1;
  EXPECT_EQ(own.time_candidates(full).front().times_ms.size(), 2u);

  KernelChooser other = chooser(2.0, 1.0);
  n_failures = 2;
  EXPECT_TRUE(other.check(at(1), full).front().times_ms.empty());
  EXPECT_EQ(other.forward_name(), "segmented");
  n_failures = 2;
  EXPECT_TRUE(other.time_candidates(full).empty());
}

/// Several processes render views together: what is timed must be such a view, with the kernel in use.
TEST_F(KernelChooserTest, RendersViewsAsItIsTold) {
  KernelChooser own = chooser(1.0, 2.0);
  std::vector<ForwardKernel> rendered;
  BlendInput by_others = input();
  by_others.render = [&](const CameraView& view, const RenderSettings& settings) {
    rendered.push_back(settings.kernel);
    return rasterizer.forward(gaussians, view, settings);
  };
  own.check(at(1), by_others);
  own.time_candidates(by_others);
  EXPECT_GE(rendered.size(), 6u);
  for (const ForwardKernel kernel : rendered) EXPECT_EQ(kernel, ForwardKernel::kSegmented);
}

TEST_F(KernelChooserTest, KeepsTheBalancedKernelWhileItIsFaster) {
  KernelChooser own = chooser(1.0, 2.0);
  EXPECT_EQ(own.check(at(1), input())[0].message, "");
  EXPECT_EQ(own.forward_name(), "segmented");
  EXPECT_TRUE(own.is_due(at(1000, 1e6)));
}

TEST_F(KernelChooserTest, UsesAllViewsIfTimesAreInconclusive) {
  EXPECT_EQ(chooser(1.015, 1.0).check(at(1), input()).front().views, 5);
}

TEST_F(KernelChooserTest, UsesFewerViewsIfMoreWouldCostTooMuch) {
  // Only the budget can end this check early: with so small a lead more views would help.
  const KernelDecision decision = chooser(1.015, 1.0).check(at(1, 1e-9), input()).front();
  EXPECT_EQ(decision.views, KernelSelector::kMinViews);
  EXPECT_GT(decision.cost_ms, 0);
}

TEST_F(KernelChooserTest, DisablesAFasterKernelWithAWrongImage) {
  KernelChooser own = chooser_with_wrong({"shared-memory"}, 2.0, 1.0);
  const KernelDecision decision = own.check(at(1), input()).front();
  EXPECT_EQ(decision.disabled, (std::vector<std::string>{"shared-memory"}));
  EXPECT_EQ(decision.times_ms.count("shared-memory"), 0u) << "a disabled kernel is not timed";
  EXPECT_NE(decision.reason.find("shared-memory is disabled: its image differs"), std::string::npos);
  EXPECT_EQ(own.forward_name(), "segmented");
  EXPECT_FALSE(own.is_due(at(1000, 1e6))) << "only one candidate is left";
}

TEST_F(KernelChooserTest, ReplacesTheKernelInUseIfItsImageIsWrong) {
  KernelChooser own = chooser_with_wrong({"segmented"}, 1.0, 2.0);
  EXPECT_EQ(own.check(at(1), input()).front().disabled, (std::vector<std::string>{"segmented"}));
  EXPECT_EQ(own.forward_name(), "shared-memory");
}

TEST_F(KernelChooserTest, UsesTheReferenceIfAllImagesAreWrong) {
  KernelChooser own = chooser_with_wrong({"segmented", "shared-memory"}, 1.0, 2.0);
  EXPECT_EQ(own.check(at(1), input()).front().disabled.size(), 2u);
  EXPECT_EQ(own.forward_name(), "naive");
}

TEST_F(KernelChooserTest, DoesNotAffectLaterRenders) {
  const RenderedView before = rasterizer.forward(gaussians, cameras[0], {});
  const torch::Tensor color = before.color.clone();
  KernelChooser own = chooser(2.0, 1.0);
  own.check(at(1), input());
  EXPECT_TRUE(test::same(rasterizer.forward(gaussians, cameras[0], {}).color, color));
}

TEST_F(KernelChooserTest, DecidesNothingOnViewsThatCannotBeRendered) {
  GaussianTensors broken = gaussians;
  broken.log_scales = torch::full_like(gaussians.log_scales, std::numeric_limits<float>::quiet_NaN());
  KernelChooser own = chooser(2.0, 1.0);
  const KernelDecision decision = own.check(at(1), input_of(broken)).front();
  EXPECT_EQ(decision.after, "segmented");
  EXPECT_TRUE(decision.times_ms.empty());
  own.check(at(1000, 1e6), input());
  EXPECT_EQ(own.forward_name(), "shared-memory");
}

TEST_F(KernelChooserTest, FixesTheKernelThatIsNamed) {
  config.kernel = "gaussian-wise";
  KernelChooser own(config, torch::kCPU);
  EXPECT_FALSE(own.is_due(at(1)));
  EXPECT_EQ(own.apply({}).kernel, ForwardKernel::kGaussianWise);
}

TEST_F(KernelChooserTest, DoesAsThePaperIfToldSo) {
  config.kernel = kPublishedKernel;
  KernelChooser own = chooser(2.0, 1.0);
  EXPECT_EQ(own.forward_name(), "combined");
  EXPECT_FALSE(own.is_due(at(1)));
  EXPECT_FALSE(own.is_due(at(999)));
  ASSERT_TRUE(own.is_due(at(1000, 1e-9))) << "regardless of its cost";
  const KernelDecision decision = own.check(at(1000, 1e-9), input()).front();
  EXPECT_EQ(decision.views, 5) << "all views";
  EXPECT_EQ(decision.times_ms.at("combined"), 2.0);
  EXPECT_EQ(own.forward_name(), "shared-memory");
  EXPECT_FALSE(own.is_due(at(2000, 1e6)));
}

TEST_F(KernelChooserTest, DoesNotTimeKernelsInDeterministicTraining) {
  config.deterministic = true;
  KernelChooser published(
      [&] {
        TrainConfig of_published = config;
        of_published.kernel = kPublishedKernel;
        return of_published;
      }(),
      torch::kCPU);
  EXPECT_FALSE(published.is_due(at(1000)));
  EXPECT_EQ(published.apply({}).kernel, ForwardKernel::kSharedMemory);
  KernelChooser own(config, torch::kCPU);
  EXPECT_FALSE(own.is_due(at(1)));
  EXPECT_EQ(own.apply({}).kernel, ForwardKernel::kSharedMemory);
}

TEST_F(KernelChooserTest, ContinuesFromACheckpoint) {
  KernelChooser own = chooser(2.0, 1.0);
  own.check(at(1), input());
  KernelChooser read(config, torch::kCPU);
  read.restore(nlohmann::ordered_json::parse(own.to_json().dump()), "a.b3dgs");
  EXPECT_EQ(read.forward_name(), "shared-memory");
  EXPECT_FALSE(read.is_due(at(1000, 1e6)));
  read.restore(nlohmann::ordered_json::object(), "from before there were checks");
  EXPECT_EQ(read.forward_name(), "shared-memory");
  EXPECT_TRUE(test::fails_with<InputError>({"a.b3dgs", "kernel checks"}, [&] {
    read.restore({{"forward", {{"kernel", 3}}}}, "a.b3dgs");
  }));
}

/// A random image and a copy of it.
struct TwoImages {
  TwoImages() {
    torch::manual_seed(3);
    reference = {torch::rand({100, 200, 3}), {}, torch::rand({100, 200})};
    image = {reference.color.clone(), {}, reference.alpha.clone()};
  }
  RenderedView reference, image;
};

// Times differ from run to run. The list of the scene's only tile is long enough for segmented to cut the tile.
TEST(KernelChoice, ByTimeChangesNoByteOfATrainingOnACpu) {
  test::TinySceneOptions options;
  options.n_gaussians = 9000;
  options.n_views = 6;
  options.width = options.height = 16;
  options.log_scale = -3.5f;
  const Scene scene = test::make_tiny_scene(options);
  const test::TempDir temp;
  TrainConfig config = test::eventful_config();
  config.kernel = "adaptive";
  config.init_opacity = 0.006;  // light passes through the whole list
  config.iterations = 4;
  const auto train_with = [&](double in_use_ms, double other_ms, const std::string& chosen) {
    TrainHooks hooks = test::slow_training();
    hooks.time_kernels = invented_times(in_use_ms, other_ms);
    const test::Trained run = test::train(config, scene, temp / chosen, {}, hooks);
    EXPECT_EQ(read_checkpoint_header(run.result.checkpoint)["kernel_selection"]["forward"]["kernel"], chosen);
    return run.ply;
  };
  const std::string switched = train_with(2, 1, "shared-memory");
  EXPECT_TRUE(test::same(train_with(1, 2, "segmented"), switched));
}

TEST(ImageFault, AllowsRoundingEverywhereAndAFewFlips) {
  TwoImages two;
  EXPECT_EQ(image_fault(two.image, two.reference), "");
  two.image.color += 5e-5 * torch::randn_like(two.image.color).clamp(-1, 1);
  two.image.alpha -= 5e-5;
  two.image.color[3][7][1] += 0.0039;
  two.image.color[50][60] -= 0.01;
  EXPECT_EQ(image_fault(two.image, two.reference), "");
}

TEST(ImageFault, GrowsWithTheRangeOfTheImage) {
  TwoImages two;
  two.reference.color[0][0][0] = 40;
  two.image.color[0][0][0] = 40;
  two.image.color += 1e-3;
  EXPECT_EQ(image_fault(two.image, two.reference), "");
}

TEST(ImageFault, ReportsWhatRoundingCannotExplain) {
  TwoImages off, flipped, wrong, faded, hole;
  off.image.color += 1e-3;  // small, but at all pixels
  EXPECT_NE(image_fault(off.image, off.reference).find("20000 pixels"), std::string::npos);
  flipped.image.color[10] += 0.004;  // a flip in each pixel of a row
  EXPECT_NE(image_fault(flipped.image, flipped.reference), "");
  wrong.image.color[99][199][2] += 0.5;  // in a single pixel
  EXPECT_NE(image_fault(wrong.image, wrong.reference).find("1 pixels by up to 0.5"), std::string::npos);
  faded.image.alpha[0][0] -= 0.1;
  EXPECT_NE(image_fault(faded.image, faded.reference), "");
  hole.image.color[5][5][0] = std::numeric_limits<float>::quiet_NaN();
  EXPECT_NE(image_fault(hole.image, hole.reference), "");
}

TEST(GradientFault, ComparesEachColumnRelativeToItsNorm) {
  torch::manual_seed(4);
  const torch::Tensor scale = torch::logspace(-6, 6, 10, 10);
  const torch::Tensor reference = torch::randn({5000, 10}) * scale;
  EXPECT_EQ(gradient_fault(reference * 1.0003, reference), "");
  EXPECT_EQ(gradient_fault(torch::zeros({0, 10}), torch::zeros({0, 10})), "");
  EXPECT_EQ(gradient_fault(torch::zeros({5, 10}), torch::zeros({5, 10})), "");
  torch::Tensor wrong = reference.clone();
  wrong.select(1, 0) *= 1.01;  // the smallest column
  EXPECT_NE(gradient_fault(wrong, reference), "");
  wrong = reference.clone();
  wrong[17][4] = std::numeric_limits<float>::quiet_NaN();
  EXPECT_NE(gradient_fault(wrong, reference), "");
  EXPECT_NE(gradient_fault(torch::full({5, 10}, 1e-3), torch::zeros({5, 10})), "");
}

}  // namespace
}  // namespace b3dgs
