#include "train/quality/metrics.h"

#include <gtest/gtest.h>

#include <fstream>

#include "core/check.h"
#include "support/expect_error.h"
#include "support/temp_dir.h"
#include "support/train/tiny_scene.h"
#include "support/train/torchscript_file.h"

namespace b3dgs {
namespace {

using test::fails_with;
using test::write_network;

class Lpips : public testing::Test {
 protected:
  std::filesystem::path network(const std::string& body) const {
    const std::filesystem::path file = folder_ / "net.pt";
    write_network(file, body);
    return file;
  }
  test::TempDir folder_;
};

/// Returns an image of 3 x 2 pixels, where pixel i is {10 i, 20 i, 30 i}.
Image8 steps() {
  Image8 image(3, 2, 3);
  for (int i = 0; i < 6; ++i) {
    for (int c = 0; c < 3; ++c)
      image.pixels[static_cast<std::size_t>(3 * i + c)] = static_cast<std::uint8_t>(10 * i * (c + 1));
  }
  return image;
}

TEST_F(Lpips, GivesTheNetworkPlanesBetween0And1) {
  // The network returns the green value of the pixel in row 1, column 2 of one image, with the sizes as digits.
  const LpipsNetwork network(this->network("    return b[0, 1, 1, 2] + a.size(2) * 10 + a.size(3) * 100"), torch::kCPU);
  const torch::Tensor rendered = torch::full({2, 3, 3}, 0.5f);
  EXPECT_NEAR(network.distance(rendered, steps(), nullptr), 100.0 / 255 + 20 + 300, 1e-4);
  EXPECT_EQ(network.name(), "net.pt");
}

TEST_F(Lpips, RoundsAndClampsTheRenderAsItWouldBeSaved) {
  const LpipsNetwork network(this->network("    return (a - b).abs().max()"), torch::kCPU);
  Image8 white(3, 2, 3);
  std::fill(white.pixels.begin(), white.pixels.end(), 255);
  EXPECT_EQ(network.distance(torch::full({2, 3, 3}, 1.7f), white, nullptr), 0);
  EXPECT_NEAR(network.distance(torch::full({2, 3, 3}, 0.5f), white, nullptr), 127.0 / 255, 1e-6);
}

TEST_F(Lpips, InvalidPixelsAreBlackInBoth) {
  const LpipsNetwork network(this->network("    return (a - b).abs().sum()"), torch::kCPU);
  const torch::Tensor rendered = torch::zeros({2, 3, 3});
  Image8 valid(3, 2, 1);
  std::fill(valid.pixels.begin(), valid.pixels.end(), 255);
  valid.pixels[5] = 0;
  const double all = network.distance(rendered, steps(), nullptr);
  EXPECT_NEAR(all - network.distance(rendered, steps(), &valid), (50 + 100 + 150) / 255.0, 1e-5);
}

TEST_F(Lpips, MeanOverTheViewsIsPartOfTheEvaluation) {
  const Scene scene = test::make_tiny_scene();
  const LpipsNetwork network(this->network("    return (a - b).abs().mean()"), torch::kCPU);
  const GaussianTensors gaussians = to_tensors(splats_from_points(scene.points, 0), 0, torch::kCPU);
  Rasterizer rasterizer(torch::kCPU);
  const Evaluation with = evaluate_views(rasterizer, gaussians, scene.train, RenderSettings{}, {}, &network);
  double sum = 0;
  for (const ViewQuality& view : with.views) {
    ASSERT_TRUE(view.quality.lpips.has_value());
    EXPECT_GT(*view.quality.lpips, 0);
    sum += *view.quality.lpips;
  }
  EXPECT_NEAR(with.mean.lpips.value(), sum / static_cast<double>(with.views.size()), 1e-12);
  EXPECT_EQ(with.lpips_network, "net.pt");
  const Evaluation without = evaluate_views(rasterizer, gaussians, scene.train, RenderSettings{});
  EXPECT_FALSE(without.mean.lpips.has_value());
  EXPECT_EQ(without.mean.psnr, with.mean.psnr);
}

TEST_F(Lpips, BadNetworksAreOneLine) {
  EXPECT_TRUE(fails_with<InputError>({"LPIPS network not found: ", "none.pt"},
                                     [&] { LpipsNetwork(folder_ / "none.pt", torch::kCPU); }));
  std::ofstream(folder_ / "text.pt") << "not a network";
  EXPECT_TRUE(fails_with<InputError>({"text.pt: expected a TorchScript network"},
                                     [&] { LpipsNetwork(folder_ / "text.pt", torch::kCPU); }));
  const torch::Tensor rendered = torch::zeros({2, 3, 3});
  for (const char* body : {"    return a - b", "    return a.size(0)", "    return a.view(7) - b"}) {
    const LpipsNetwork network(this->network(body), torch::kCPU);
    EXPECT_TRUE(fails_with<InputError>({"net.pt: expected forward(a, b)", "returns one number"}, [&] {
      network.distance(rendered, steps(), nullptr);
    })) << body;
  }
}

}  // namespace
}  // namespace b3dgs
