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
class InventedTimer final : public KernelTimer {
 public:
  InventedTimer(double in_use_ms, double other_ms) : ms_{in_use_ms, other_ms} {}
  void measure(const std::function<void()>& work) override {
    work();
    ++n_measured_;
  }
  std::vector<double> finish() override {
    std::vector<double> times(std::exchange(n_measured_, 0), 0.0);
    if (times.size() != 2) return times;
    const bool is_swapped = n_views_++ % 2 == 1;  // the order alternates
    return is_swapped ? std::vector<double>{ms_[1], ms_[0]} : std::vector<double>{ms_[0], ms_[1]};
  }

 private:
  double ms_[2];
  std::size_t n_measured_ = 0;
  int n_views_ = 0;
};

/// All kernels compute the same, except for some that each compute something different.
class WrongBlend final : public BlendPass {
 public:
  explicit WrongBlend(std::set<std::string> wrong) : wrong_(std::move(wrong)) {}
  void prepare(const CameraView&) override {}
  void run(const std::string& kernel) override { image_ = wrong_.count(kernel) > 0 ? kernel : ""; }
  void keep() override { kept_ = image_; }
  std::string fault() const override { return image_ == kept_ ? "" : "its image differs"; }

 private:
  std::set<std::string> wrong_;
  std::string image_, kept_;
};

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
    return KernelChooser(config, torch::kCPU, {std::make_unique<InventedTimer>(in_use_ms, other_ms)});
  }
  /// Like chooser(), but some kernels compute something different.
  KernelChooser chooser_with_wrong(const std::set<std::string>& kernels, double in_use_ms, double other_ms) {
    KernelCheckTools tools{std::make_unique<InventedTimer>(in_use_ms, other_ms)};
    tools.make_forward = [=](const BlendInput&) { return std::make_unique<WrongBlend>(kernels); };
    return KernelChooser(config, torch::kCPU, std::move(tools));
  }

  const Scene scene = test::make_tiny_scene();
  const GaussianTensors gaussians = to_tensors(splats_from_points(scene.points, 0), 0, torch::kCPU);
  TrainConfig config;
  Rasterizer rasterizer{torch::kCPU};
  std::vector<CameraView> cameras;
};

TEST(KernelTimer, GivesATimeForEachPieceOfWorkOnce) {
  const std::unique_ptr<KernelTimer> timer = make_kernel_timer(torch::kCPU);
  int n_done = 0;
  for (int round = 1; round <= 2; ++round) {
    for (int piece = 0; piece < 3; ++piece) timer->measure([&] { ++n_done; });
    EXPECT_EQ(n_done, 3 * round);
    const std::vector<double> ms = timer->finish();
    ASSERT_EQ(ms.size(), 3u);
    for (const double each : ms) EXPECT_GE(each, 0);
    EXPECT_TRUE(timer->finish().empty());
  }
}

TEST_F(KernelChooserTest, SwitchesToTheFasterKernel) {
  KernelChooser own = chooser(2.0, 1.0);
  EXPECT_EQ(own.apply({}).kernel, ForwardKernel::kSegmented);
  ASSERT_TRUE(own.is_due(at(1)));
  const std::vector<KernelCheck> done = own.check(at(1), input());
  ASSERT_EQ(done.size(), 1u) << "the CPU has only one backward kernel";
  EXPECT_STREQ(done[0].pass, "forward");
  EXPECT_EQ(done[0].decision.views, 3) << "three are enough to find a factor of two";
  EXPECT_EQ(done[0].decision.times_ms.at("segmented"), 2.0);
  EXPECT_EQ(done[0].decision.times_ms.at("shared-memory"), 1.0);
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
  EXPECT_EQ(own.check(at(1), full).front().decision.times_ms.at("shared-memory"), 1.0);
  EXPECT_EQ(own.forward_name(), "shared-memory");
  EXPECT_EQ(n_freed, 1);
  n_failures = 1;
  EXPECT_EQ(own.time_candidates(full).front().times.times_ms.size(), 2u);

  KernelChooser other = chooser(2.0, 1.0);
  n_failures = 2;
  EXPECT_TRUE(other.check(at(1), full).front().decision.times_ms.empty());
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
  EXPECT_EQ(chooser(1.015, 1.0).check(at(1), input()).front().decision.views, 5);
}

TEST_F(KernelChooserTest, UsesFewerViewsIfMoreWouldCostTooMuch) {
  // Only the budget can end this check early: with so small a lead more views would help.
  const KernelDecision decision = chooser(1.015, 1.0).check(at(1, 1e-9), input()).front().decision;
  EXPECT_EQ(decision.views, KernelSelector::kMinViews);
  EXPECT_GT(decision.cost_ms, 0);
}

TEST_F(KernelChooserTest, DisablesAFasterKernelWithAWrongImage) {
  KernelChooser own = chooser_with_wrong({"shared-memory"}, 2.0, 1.0);
  const KernelDecision decision = own.check(at(1), input()).front().decision;
  EXPECT_EQ(decision.disabled, (std::vector<std::string>{"shared-memory"}));
  EXPECT_EQ(decision.times_ms.count("shared-memory"), 0u) << "a disabled kernel is not timed";
  EXPECT_NE(decision.reason.find("shared-memory is disabled: its image differs"), std::string::npos);
  EXPECT_EQ(own.forward_name(), "segmented");
  EXPECT_FALSE(own.is_due(at(1000, 1e6))) << "only one candidate is left";
}

TEST_F(KernelChooserTest, ReplacesTheKernelInUseIfItsImageIsWrong) {
  KernelChooser own = chooser_with_wrong({"segmented"}, 1.0, 2.0);
  EXPECT_EQ(own.check(at(1), input()).front().decision.disabled, (std::vector<std::string>{"segmented"}));
  EXPECT_EQ(own.forward_name(), "shared-memory");
}

TEST_F(KernelChooserTest, UsesTheReferenceIfAllImagesAreWrong) {
  KernelChooser own = chooser_with_wrong({"segmented", "shared-memory"}, 1.0, 2.0);
  EXPECT_EQ(own.check(at(1), input()).front().decision.disabled.size(), 2u);
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
  const KernelDecision decision = own.check(at(1), input_of(broken)).front().decision;
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
  const KernelDecision decision = own.check(at(1000, 1e-9), input()).front().decision;
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
    hooks.make_kernel_timer = [=] { return std::make_unique<InventedTimer>(in_use_ms, other_ms); };
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
