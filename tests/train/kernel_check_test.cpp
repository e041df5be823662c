// Checks of the kernels on a tiny scene, with a timer whose times are invented, and what counts as the same image.
#include "train/kernel_check.h"

#include <gtest/gtest.h>
#include <torch/torch.h>

#include <limits>

#include "check.h"
#include "support/expect_error.h"
#include "train/kernel_agreement.h"
#include "train/tiny_scene.h"

namespace b3dgs {
namespace {

/// Does the work, and says that it took as long as is written down for the kernel in use and for the other one.
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

class KernelChecksTest : public testing::Test {
 protected:
  void SetUp() override {
    for (const View& view : scene.train) cameras.push_back(to_pinhole_view(view.camera));
    ASSERT_GE(cameras.size(), 5u);
    cameras.resize(5);
  }
  KernelCheckInput input(double step_ms = 0) { return {rasterizer, gaussians, {}, cameras, step_ms}; }
  KernelChecks checks(double in_use_ms, double other_ms) {
    return KernelChecks(config, torch::kCPU, std::make_unique<InventedTimer>(in_use_ms, other_ms));
  }

  const Scene scene = test::make_tiny_scene();
  const GaussianTensors gaussians = to_tensors(splats_from_points(scene.points, 0), 0, torch::kCPU);
  TrainConfig config;
  Rasterizer rasterizer{torch::kCPU};
  std::vector<PinholeView> cameras;
};

TEST_F(KernelChecksTest, GoOverToTheKernelThatTakesLessTime) {
  KernelChecks own = checks(2.0, 1.0);
  EXPECT_EQ(own.apply({}).kernel, ForwardKernel::kCombined);
  ASSERT_TRUE(own.is_due(1));
  const std::vector<KernelCheck> done = own.check(1, input());
  ASSERT_EQ(done.size(), 1u) << "the CPU has one backward kernel";
  EXPECT_STREQ(done[0].pass, "forward");
  EXPECT_EQ(done[0].decision.views, 3) << "no more are needed to see twice the time";
  EXPECT_EQ(done[0].decision.times_ms.at("combined"), 2.0);
  EXPECT_EQ(done[0].decision.times_ms.at("shared-memory"), 1.0);
  EXPECT_EQ(done[0].message, "iteration 1: combined 2 ms, shared-memory 1 ms: shared-memory from here on");
  EXPECT_EQ(own.apply({}).kernel, ForwardKernel::kSharedMemory);
  EXPECT_EQ(own.forward_name(), "shared-memory");
  EXPECT_EQ(own.backward_name(), "");
  EXPECT_FALSE(own.is_due(1000));
}

TEST_F(KernelChecksTest, StayWithTheBalancedKernelWhileItIsFaster) {
  KernelChecks own = checks(1.0, 2.0);
  EXPECT_EQ(own.check(1, input())[0].message, "");
  EXPECT_EQ(own.forward_name(), "combined");
  EXPECT_TRUE(own.is_due(1000));
}

TEST_F(KernelChecksTest, TakeAllViewsWhereThereIsDoubt) {
  EXPECT_EQ(checks(1.015, 1.0).check(1, input()).front().decision.views, 5);
}

TEST_F(KernelChecksTest, TakeFewerViewsWhereManyWouldCostTooMuch) {
  KernelChecks own(config, torch::kCPU);
  const KernelDecision decision = own.check(1, input(1e-9)).front().decision;
  EXPECT_EQ(decision.views, KernelSelector::kMinViews);
  EXPECT_GT(decision.cost_ms, 0);
}

TEST_F(KernelChecksTest, LeaveTheRasterizerAsGoodAsNew) {
  const RenderedView before = rasterizer.forward(gaussians, cameras[0], {});
  const torch::Tensor color = before.color.clone();
  KernelChecks own = checks(2.0, 1.0);
  own.check(1, input());
  EXPECT_TRUE(torch::equal(rasterizer.forward(gaussians, cameras[0], {}).color, color));
}

TEST_F(KernelChecksTest, DecideNothingOnViewsThatCannotBeRendered) {
  GaussianTensors broken = gaussians;
  broken.log_scales = torch::full_like(gaussians.log_scales, std::numeric_limits<float>::quiet_NaN());
  KernelChecks own = checks(2.0, 1.0);
  const KernelDecision decision = own.check(1, {rasterizer, broken, {}, cameras, 0}).front().decision;
  EXPECT_EQ(decision.after, "combined");
  EXPECT_TRUE(decision.times_ms.empty());
  own.check(1000, input());
  EXPECT_EQ(own.forward_name(), "shared-memory");
}

TEST_F(KernelChecksTest, FixTheKernelThatIsNamed) {
  config.kernel = "gaussian-wise";
  KernelChecks own(config, torch::kCPU);
  EXPECT_FALSE(own.is_due(1));
  EXPECT_EQ(own.apply({}).kernel, ForwardKernel::kGaussianWise);
}

TEST_F(KernelChecksTest, ChooseNothingByTimesIfTheBytesHaveToBeTheSame) {
  config.deterministic = true;
  KernelChecks own(config, torch::kCPU);
  EXPECT_FALSE(own.is_due(1));
  EXPECT_EQ(own.apply({}).kernel, ForwardKernel::kSharedMemory);
}

TEST_F(KernelChecksTest, ContinueFromACheckpoint) {
  KernelChecks own = checks(2.0, 1.0);
  own.check(1, input());
  KernelChecks read(config, torch::kCPU);
  read.restore(nlohmann::ordered_json::parse(own.to_json().dump()), "a.b3dgs");
  EXPECT_EQ(read.forward_name(), "shared-memory");
  EXPECT_FALSE(read.is_due(1000));
  read.restore(nlohmann::ordered_json::object(), "from before there were checks");
  EXPECT_EQ(read.forward_name(), "shared-memory");
  EXPECT_TRUE(test::fails_with<InputError>({"a.b3dgs", "kernel checks"}, [&] {
    read.restore({{"forward", {{"kernel", 3}}}}, "a.b3dgs");
  }));
}

/// An image that looks like none, and a copy of it.
struct TwoImages {
  TwoImages() {
    torch::manual_seed(3);
    reference = {torch::rand({100, 200, 3}), {}, torch::rand({100, 200})};
    image = {reference.color.clone(), {}, reference.alpha.clone()};
  }
  RenderedView reference, image;
};

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

TEST(ImageFault, NamesWhatRoundingDoesNotExplain) {
  TwoImages off, flipped, wrong, faded, hole;
  off.image.color += 1e-3;  // a little, but everywhere
  EXPECT_NE(image_fault(off.image, off.reference).find("20000 pixels"), std::string::npos);
  flipped.image.color[10] += 0.004;  // a flip in each pixel of a row
  EXPECT_NE(image_fault(flipped.image, flipped.reference), "");
  wrong.image.color[99][199][2] += 0.5;  // in a single pixel
  EXPECT_NE(image_fault(wrong.image, wrong.reference).find("1 pixels, by up to 0.5"), std::string::npos);
  faded.image.alpha[0][0] -= 0.1;
  EXPECT_NE(image_fault(faded.image, faded.reference), "");
  hole.image.color[5][5][0] = std::numeric_limits<float>::quiet_NaN();
  EXPECT_NE(image_fault(hole.image, hole.reference), "");
}

TEST(GradientFault, JudgesEachColumnByItsNorm) {
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
