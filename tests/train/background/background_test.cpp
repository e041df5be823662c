// The learned background: its colours and gradients against references in double that share nothing with it, and its
// file.
#include "train/background/background.h"

#include <gtest/gtest.h>

#include <torch/csrc/autograd/autograd.h>

#include <cmath>

#include "core/files/atomic_file.h"
#include "core/parallel.h"
#include "model/formats/background_json.h"
#include "support/approx.h"
#include "support/expect_error.h"
#include "support/finite_difference.h"
#include "support/raster/dense_reference.h"
#include "support/raster/test_scenes.h"
#include "support/temp_dir.h"
#include "train/background/background_args.h"

namespace b3dgs {
namespace {

using test::within;

/// A real spherical harmonic with the Condon-Shortley sign, from the associated Legendre function.
double harmonic(int l, int m, double x, double y, double z) {
  const double theta = std::acos(z), phi = std::atan2(y, x);
  const auto order = static_cast<unsigned>(std::abs(m));
  const double along = std::sph_legendre(static_cast<unsigned>(l), order, theta);
  if (m == 0) return along;
  return std::sqrt(2.0) * along * (m > 0 ? std::cos(m * phi) : std::sin(-m * phi));
}

/// Colours [H, W, 3] of a background with coefficients [K, 3], in double.
torch::Tensor reference_colors(const PinholeView& view, const torch::Tensor& coefficients) {
  const int degree = coefficients.size(0) == 1 ? 0 : 4;
  std::vector<double> basis;
  for (int row = 0; row < view.height; ++row) {
    for (int column = 0; column < view.width; ++column) {
      const double ray[3] = {(column + 0.5 - double{view.cx}) / double{view.fx},
                             (row + 0.5 - double{view.cy}) / double{view.fy}, 1};
      double dir[3], square = 0;
      for (int axis = 0; axis < 3; ++axis) {
        dir[axis] = 0;
        for (int i = 0; i < 3; ++i) dir[axis] += double{view.rotation(i, axis)} * ray[i];
        square += dir[axis] * dir[axis];
      }
      for (double& value : dir) value /= std::sqrt(square);
      for (int l = 0; l <= degree; ++l) {
        for (int m = -l; m <= l; ++m) basis.push_back(harmonic(l, m, dir[0], dir[1], dir[2]));
      }
    }
  }
  const torch::Tensor rows =
      torch::tensor(basis, torch::kFloat64).view({std::int64_t{view.height} * view.width, coefficients.size(0)});
  return torch::sigmoid(torch::matmul(rows, coefficients.to(torch::kFloat64))).view({view.height, view.width, 3});
}

/// Larger than two parts, with a rotated camera that is wide enough to see most of a hemisphere.
PinholeView wide_view() {
  PinholeView view = test::anisotropic_cloud().view;
  view.width = 110;
  view.height = 90;
  view.fx = 40;
  view.fy = 47;
  view.cx = 50;
  view.cy = 49;
  return view;
}

torch::Tensor some_coefficients(int degree) {
  torch::manual_seed(3);
  return torch::randn({background_coefficients(degree), 3});
}

RenderedView some_render(const PinholeView& view) {
  torch::manual_seed(4);
  return {torch::rand({view.height, view.width, 3}), {}, torch::rand({view.height, view.width})};
}

TEST(Background, BasisIsThatOfTheSphericalHarmonics) {
  for (const double z : {-0.93, -0.4, 0.0, 0.31, 0.88}) {
    for (const double phi : {0.1, 1.3, 2.9, 4.4, 5.9}) {
      const double r = std::sqrt(1 - z * z), x = r * std::cos(phi), y = r * std::sin(phi);
      double basis[kBackgroundCoefficients];
      background_basis<kBackgroundDegree>(Vec3<double>{x, y, z}, basis);
      for (int l = 0, k = 0; l <= kBackgroundDegree; ++l) {
        for (int m = -l; m <= l; ++m, ++k) EXPECT_NEAR(basis[k], harmonic(l, m, x, y, z), 1e-12) << l << ", " << m;
      }
    }
  }
}

TEST(Background, ColorsAreAddedWithTheLightThatIsLeft) {
  const PinholeView view = wide_view();
  for (const int degree : {0, 4}) {
    const torch::Tensor coefficients = some_coefficients(degree);
    const RenderedView rendered = some_render(view);
    const torch::Tensor wanted =
        rendered.color.to(torch::kFloat64) +
        (1 - rendered.alpha.to(torch::kFloat64)).unsqueeze(2) * reference_colors(view, coefficients);
    add_background(coefficients, view, rendered);
    EXPECT_TRUE(within(rendered.color, wanted, 2e-6)) << degree;
  }
  const RenderedView rendered = some_render(view);
  const torch::Tensor before = rendered.color.clone();
  add_background(torch::Tensor(), view, rendered);
  EXPECT_TRUE(torch::equal(rendered.color, before)) << "no background";
}

TEST(Background, GradientsAgreeWithFiniteDifferences) {
  PinholeView view = wide_view();
  for (const int degree : {0, 4}) {
    SCOPED_TRACE(degree);
    const RenderedView rendered = some_render(view);
    const torch::Tensor weights = torch::randn({view.height, view.width, 3});
    BackgroundState background = make_background(degree, torch::kCPU);
    background.coefficients.copy_(some_coefficients(degree));
    BackgroundGradient gradient;
    const torch::Tensor grad_alpha = gradient.compute(background, view, rendered, weights);

    // The loss is the sum of weights times colours.
    const torch::Tensor light = (1 - rendered.alpha.to(torch::kFloat64)).unsqueeze(2);
    const auto loss = [&](const std::vector<double>& coefficients) {
      const torch::Tensor colors = reference_colors(view, torch::tensor(coefficients, torch::kFloat64).view({-1, 3}));
      return (weights.to(torch::kFloat64) * light * colors).sum().item<double>();
    };
    const torch::Tensor flat = background.coefficients.to(torch::kFloat64).flatten();
    const torch::Tensor found = gradient.coefficients().to(torch::kFloat64).flatten();
    const std::vector<double> at(flat.data_ptr<double>(), flat.data_ptr<double>() + flat.numel());
    const std::vector<double> analytic(found.data_ptr<double>(), found.data_ptr<double>() + found.numel());
    EXPECT_TRUE(test::gradients_agree(analytic, test::numeric_gradient(loss, at), 1e-5));

    const torch::Tensor of_alpha =
        -(weights.to(torch::kFloat64) * reference_colors(view, background.coefficients)).sum(2);
    EXPECT_TRUE(within(grad_alpha, of_alpha, 1e-5));
  }
}

TEST(Background, GradientsReachTheGaussiansAsInTheReference) {
  const test::TestScene scene = test::anisotropic_cloud();
  RenderSettings settings;
  settings.sh_degree = scene.sh_degree;
  Rasterizer rasterizer(torch::kCPU);
  const RenderedView rendered = rasterizer.forward(scene.gaussians, scene.view, settings);
  BackgroundState background = make_background(4, torch::kCPU);
  background.coefficients.copy_(some_coefficients(4));
  add_background(background.coefficients, scene.view, rendered);
  const torch::Tensor weights = torch::randn(rendered.color.sizes());
  BackgroundGradient gradient;
  GaussianTensors grads;
  rasterizer.backward(scene.gaussians, {weights, {}, gradient.compute(background, scene.view, rendered, weights)},
                      grads);

  const GaussianTensors leaves = test::to_dense_leaves(scene.gaussians);
  const test::DenseView dense = test::dense_render(leaves, scene.view, settings);
  const torch::Tensor colors = reference_colors(scene.view, background.coefficients);
  const torch::Tensor whole = dense.color + (1 - dense.alpha).unsqueeze(2) * colors;
  const torch::Tensor far = dense.near_decision.logical_not();
  EXPECT_TRUE(within(rendered.color * far.unsqueeze(2), whole * far.unsqueeze(2), 1e-5));
  std::vector<torch::Tensor> inputs;
  for (const torch::Tensor* leaf : leaves.all()) inputs.push_back(*leaf);
  const std::vector<torch::Tensor> wanted =
      torch::autograd::grad({(weights.to(torch::kFloat64) * whole).sum()}, inputs, {}, false, false, true);
  for (std::size_t i = 0; i < wanted.size(); ++i) {
    const double norm = wanted[i].norm().item<double>();
    const double error = (grads.all()[i]->to(torch::kFloat64) - wanted[i]).norm().item<double>();
    EXPECT_LE(error, 1e-4 * norm) << GaussianTensors::kNames[i];
  }
}

TEST(Background, GradientsDoNotDependOnTheNumberOfThreads) {
  const PinholeView view = wide_view();
  const RenderedView rendered = some_render(view);
  BackgroundState background = make_background(4, torch::kCPU);
  background.coefficients.copy_(some_coefficients(4));
  const torch::Tensor weights = torch::randn({view.height, view.width, 3});
  BackgroundGradient gradient;
  std::vector<torch::Tensor> found;
  for (const int threads : {1, 3}) {
    set_thread_count(threads);
    gradient.compute(background, view, rendered, weights);
    found.push_back(gradient.coefficients().clone());
  }
  set_thread_count(0);
  EXPECT_TRUE(torch::equal(found[0], found[1]));
}

TEST(Background, StepsAreThoseOfAdam) {
  const PinholeView view = wide_view();
  BackgroundState background = make_background(4, torch::kCPU);
  BackgroundGradient gradient;
  torch::Tensor m = torch::zeros({25, 3}, torch::kFloat64), v = m.clone(), expected = m.clone();
  for (int step = 1; step <= 3; ++step) {
    gradient.compute(background, view, some_render(view), torch::randn({view.height, view.width, 3}));
    const torch::Tensor g = gradient.coefficients().to(torch::kFloat64);
    m = 0.9 * m + 0.1 * g;
    v = 0.999 * v + 0.001 * g * g;
    expected = expected - 0.02 * (m / (1 - std::pow(0.9, step))) / ((v / (1 - std::pow(0.999, step))).sqrt() + 1e-15);
    gradient.step(0.02, background);
  }
  EXPECT_EQ(background.steps, 3);
  EXPECT_TRUE(within(background.coefficients, expected, 1e-6));
}

TEST(Background, RejectsTensorsThatDoNotFit) {
  const PinholeView view = wide_view();
  const RenderedView rendered = some_render(view);
  EXPECT_THROW(add_background(torch::zeros({4, 3}), view, rendered), LogicError);
  EXPECT_THROW(add_background(torch::zeros({25, 3}), wide_view(), some_render(test::one_splat().view)), LogicError);
  EXPECT_FALSE(make_background(-1, torch::kCPU).is_defined());
}

TEST(BackgroundJson, IsReadAsItWasWritten) {
  const test::TempDir temp;
  const std::filesystem::path path = background_path(temp / "model/point_cloud.ply");
  EXPECT_EQ(path.filename(), "background.json");
  EXPECT_FALSE(read_background_json(path).has_value());
  for (const std::size_t n : {3, 75}) {
    BackgroundSh background;
    for (std::size_t i = 0; i < n; ++i) background.coefficients.push_back(0.1f * static_cast<float>(i) - 1.0f / 3);
    write_background_json(path, background);
    EXPECT_EQ(read_background_json(path).value().coefficients, background.coefficients);
  }
}

TEST(BackgroundJson, RejectsDamagedFiles) {
  const test::TempDir temp;
  const std::filesystem::path path = temp / "background.json";
  const auto complaint_has = [&](const std::string& text, const std::string& words) {
    write_file(path, text);
    return test::fails_with<InputError>({path.string(), words}, [&] { read_background_json(path); });
  };
  EXPECT_TRUE(complaint_has("{", "not a JSON object"));
  EXPECT_TRUE(complaint_has("[]", "not a JSON object"));
  EXPECT_TRUE(complaint_has("{}", "unexpected content"));
  EXPECT_TRUE(complaint_has(R"({"sh_degree": 2, "coefficients": []})", "expected 0 or 4, found 2"));
  EXPECT_TRUE(complaint_has(R"({"sh_degree": 4, "coefficients": [[0, 0, 0]]})", "expected 25 rows"));
  EXPECT_TRUE(complaint_has(R"({"sh_degree": 0, "coefficients": 7})", "expected 1 rows for sh_degree 0, found 7"));
  EXPECT_TRUE(complaint_has(R"({"sh_degree": 0, "coefficients": [[0, 0]]})", "three numbers"));
  EXPECT_TRUE(complaint_has(R"({"sh_degree": 0, "coefficients": [[0, 0, 1e300]]})", "finite"));
  EXPECT_TRUE(complaint_has(R"({"sh_degree": 0, "coefficients": [[0, 0, "x"]]})", "unexpected content"));
}

}  // namespace
}  // namespace b3dgs
