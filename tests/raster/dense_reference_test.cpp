// Tests the dense reference against hand calculations, and its autograd gradients against finite differences.
#include "support/raster/dense_reference.h"
#include "support/raster/clamped_scene.h"
#include "support/raster/cpu_harness.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <string>
#include <vector>

#include "support/approx.h"
#include "support/finite_difference.h"
#include "support/raster/test_scenes.h"

namespace b3dgs::test {
namespace {

constexpr double kShDegree0 = 0.28209479177387814;
constexpr double kShDegree1 = 0.4886025119029199;

double at(const torch::Tensor& tensor, std::initializer_list<std::int64_t> place) {
  torch::Tensor value = tensor;
  for (std::int64_t i : place) value = value[i];
  return value.item<double>();
}

/// Makes a view of 9 x 9 px with focal length 10 and pixel (4, 4) on the optical axis.
PinholeView axis_view() {
  PinholeView view{};
  view.rotation = {{1, 0, 0, 0, 1, 0, 0, 0, 1}};
  view.fx = view.fy = 10;
  view.cx = view.cy = 4.5f;
  view.width = view.height = 9;
  return view;
}

struct Row {
  std::array<double, 3> mean;
  std::array<double, 3> scale;
  std::array<double, 4> quat;
  double opacity;
  double color;  // grey, degree 0
};

GaussianTensors leaves_of(const std::vector<Row>& rows) {
  const std::int64_t n = static_cast<std::int64_t>(rows.size());
  GaussianTensors g;
  g.means = torch::zeros({n, 3}, torch::kFloat64);
  g.log_scales = torch::zeros({n, 3}, torch::kFloat64);
  g.quats = torch::zeros({n, 4}, torch::kFloat64);
  g.logit_opacities = torch::zeros({n}, torch::kFloat64);
  g.sh0 = torch::zeros({n, 1, 3}, torch::kFloat64);
  g.shN = torch::zeros({n, 15, 3}, torch::kFloat64);
  for (std::int64_t i = 0; i < n; ++i) {
    const Row& row = rows[static_cast<std::size_t>(i)];
    for (int c = 0; c < 3; ++c) {
      g.means[i][c] = row.mean[c];
      g.log_scales[i][c] = std::log(row.scale[c]);
      g.sh0[i][0][c] = (row.color - 0.5) / kShDegree0;
    }
    for (int c = 0; c < 4; ++c) g.quats[i][c] = row.quat[c];
    g.logit_opacities[i] = std::log(row.opacity / (1 - row.opacity));
  }
  return to_dense_leaves(g);
}

Row ball(double depth, double size, double opacity, double color) {
  return {{0, 0, depth}, {size, size, size}, {1, 0, 0, 0}, opacity, color};
}

TEST(DenseReference, RendersOneSplatAsByHand) {
  RenderSettings settings;
  settings.background = {0.25f, 0.5f, 1.0f};
  const DenseView view = dense_render(leaves_of({ball(2, 0.4, 0.6, 0.8)}), axis_view(), settings);

  // The standard deviation is 10 / 2 * 0.4 = 2 px, so the variance with the blur is 4.3 px^2.
  EXPECT_NEAR(at(view.alpha, {4, 4}), 0.6, 1e-12);
  EXPECT_NEAR(at(view.depth, {4, 4}), 0.6 * 2, 1e-12);
  EXPECT_NEAR(at(view.color, {4, 4, 0}), 0.6 * 0.8 + 0.4 * 0.25, 1e-12);
  EXPECT_NEAR(at(view.color, {4, 4, 2}), 0.6 * 0.8 + 0.4 * 1.0, 1e-12);
  EXPECT_NEAR(at(view.alpha, {4, 6}), 0.6 * std::exp(-0.5 * 4 / (4 + 0.3)), 1e-8);
  EXPECT_NEAR(at(view.alpha, {1, 6}), 0.6 * std::exp(-0.5 * 13 / (4 + 0.3)), 1e-8);
  EXPECT_EQ(view.radii[0].item<int>(), 7);  // 3 * sqrt(4.3) = 6.22
  EXPECT_EQ(view.last_gaussians[4][4].item<int>(), 0);
  EXPECT_EQ(view.n_blended[4][4].item<int>(), 1);
}

TEST(DenseReference, ProjectsTheCentreWithPixelCentresAtHalves) {
  const GaussianTensors leaves = leaves_of({{{0.4, -0.2, 2}, {0.01, 0.01, 0.01}, {1, 0, 0, 0}, 0.9, 0.5}});
  const DenseView view = dense_render(leaves, axis_view(), {});

  EXPECT_NEAR(at(view.means2d, {0, 0}), 4.5 + 2, 1e-12);
  EXPECT_NEAR(at(view.means2d, {0, 1}), 4.5 - 1, 1e-12);
  EXPECT_NEAR(at(view.alpha, {3, 6}), 0.9, 1e-12);  // row 3, column 6: +x right, +y down
}

TEST(DenseReference, TurnsFromFirstToSecondAxis) {
  // A positive rotation about z turns +x towards +y, which is down, so the long axis runs down to the right.
  const double angle = 30 * M_PI / 180;
  const GaussianTensors leaves =
      leaves_of({{{0, 0, 1}, {0.3, 0.1, 0.1}, {2 * std::cos(angle / 2), 0, 0, 2 * std::sin(angle / 2)}, 0.9, 0.5}});
  const DenseView view = dense_render(leaves, axis_view(), {});

  const double xx = 9 * 0.75 + 1 * 0.25 + 0.3, yy = 9 * 0.25 + 1 * 0.75 + 0.3;
  const double xy = (9 - 1) * std::cos(angle) * std::sin(angle);
  const auto alpha = [&](double dx, double dy) {
    const double sigma = 0.5 * (yy * dx * dx - 2 * xy * dx * dy + xx * dy * dy) / (xx * yy - xy * xy);
    return 0.9 * std::exp(-sigma);
  };
  EXPECT_NEAR(at(view.alpha, {6, 7}), alpha(3, 2), 1e-8);
  EXPECT_NEAR(at(view.alpha, {2, 7}), alpha(3, -2), 1e-8);
  EXPECT_GT(at(view.alpha, {6, 7}), 3 * at(view.alpha, {2, 7}));
}

TEST(DenseReference, WidensSplatsOffTheAxisByThePerspective) {
  // At x/z = 0.4, the extent of the splat in depth contributes too: variance (f/z)^2 s^2 (1 + 0.4^2).
  const DenseView view =
      dense_render(leaves_of({{{0.8, 0, 2}, {0.4, 0.4, 0.4}, {1, 0, 0, 0}, 0.9, 0.5}}), axis_view(), {});
  EXPECT_NEAR(at(view.alpha, {4, 6}), 0.9 * std::exp(-0.5 * 4 / (4 * 1.16 + 0.3)), 1e-8);
  EXPECT_NEAR(at(view.alpha, {6, 8}), 0.9 * std::exp(-0.5 * 4 / (4 + 0.3)), 1e-8);
}

TEST(DenseReference, ClampsTheSlopeOfTheProjectionBeyondTheExtendedImage) {
  // The image ends at x/z = 0.45, and the projection is linearised up to 0.45 * 1.3. The centre itself is not moved.
  PinholeView camera = axis_view();
  camera.cx = 3.5f;  // now from -0.35 to 0.55, extended by 0.3 * 0.45 on both sides
  const DenseView view = dense_render(leaves_of({{{2, 0, 2}, {0.8, 0.8, 0.8}, {1, 0, 0, 0}, 0.9, 0.5}}), camera, {});
  const double slope = 0.55 + 0.135;
  EXPECT_NEAR(at(view.means2d, {0, 0}), 13.5, 1e-6);
  EXPECT_NEAR(at(view.alpha, {4, 8}), 0.9 * std::exp(-0.5 * 25 / (16 * (1 + slope * slope) + 0.3)), 1e-7);

  const DenseView left = dense_render(leaves_of({{{-2, 0, 2}, {0.8, 0.8, 0.8}, {1, 0, 0, 0}, 0.9, 0.5}}), camera, {});
  const double left_slope = 0.35 + 0.135;
  EXPECT_NEAR(at(left.alpha, {4, 0}), 0.9 * std::exp(-0.5 * 49 / (16 * (1 + left_slope * left_slope) + 0.3)), 1e-7);
}

TEST(DenseReference, BlendsNearestFirst) {
  const DenseView view = dense_render(leaves_of({ball(3, 0.5, 0.5, 0.2), ball(2, 0.5, 0.25, 1.0)}), axis_view(), {});
  EXPECT_NEAR(at(view.color, {4, 4, 1}), 0.25 * 1.0 + 0.75 * 0.5 * 0.2, 1e-12);
  EXPECT_NEAR(at(view.depth, {4, 4}), 0.25 * 2 + 0.75 * 0.5 * 3, 1e-12);
  EXPECT_NEAR(at(view.alpha, {4, 4}), 1 - 0.75 * 0.5, 1e-12);
  EXPECT_EQ(view.last_gaussians[4][4].item<int>(), 0);
}

TEST(DenseReference, OrdersEqualDepthsByIndex) {
  const DenseView view = dense_render(leaves_of({ball(2, 0.5, 0.5, 0.2), ball(2, 0.5, 0.25, 1.0)}), axis_view(), {});
  EXPECT_NEAR(at(view.color, {4, 4, 1}), 0.5 * 0.2 + 0.5 * 0.25 * 1.0, 1e-12);
}

TEST(DenseReference, EndsThePixelBeforeTheGaussianThatWouldSaturateIt) {
  // 0.05, 0.0025, 1.25e-4. The fourth would leave 6.25e-6, and the faint one is behind the end.
  std::vector<Row> rows;
  for (int i = 0; i < 4; ++i) rows.push_back(ball(2 + i, 50, 0.95, 0.5));
  rows.push_back(ball(9, 50, 0.1, 0.5));
  const DenseView view = dense_render(leaves_of(rows), axis_view(), {});
  EXPECT_NEAR(at(view.alpha, {4, 4}), 1 - 1.25e-4, 1e-12);
  EXPECT_NEAR(at(view.depth, {4, 4}), 0.95 * 2 + 0.05 * 0.95 * 3 + 0.0025 * 0.95 * 4, 1e-12);
  EXPECT_EQ(view.last_gaussians[4][4].item<int>(), 2);
  EXPECT_FALSE(view.contributes[3].item<bool>());
  EXPECT_FALSE(view.contributes[4].item<bool>());
}

TEST(DenseReference, CapsAlphaAndStopsTheGradientThere) {
  const GaussianTensors leaves = leaves_of({ball(2, 0.4, 0.999, 0.8)});
  const DenseView view = dense_render(leaves, axis_view(), {});
  EXPECT_NEAR(at(view.alpha, {4, 4}), 0.99, 1e-12);
  EXPECT_NEAR(at(view.color, {4, 4, 0}), 0.99 * 0.8, 1e-12);

  RenderedViewGrad grad;
  grad.alpha = torch::zeros({9, 9});
  grad.alpha[4][4] = 1.0;
  EXPECT_EQ(dense_gradients(leaves, view, grad).parameters.logit_opacities[0].item<double>(), 0.0);
  grad.alpha[4][4] = 0.0;
  grad.alpha[4][6] = 1.0;
  EXPECT_NEAR(dense_gradients(leaves, view, grad).parameters.logit_opacities[0].item<double>(),
              0.999 * 0.001 * std::exp(-0.5 * 4 / 4.3), 1e-9);
}

TEST(DenseReference, SkipsWhatIsBelowTheCutoff) {
  const DenseView view = dense_render(leaves_of({ball(2, 0.4, 0.0039, 0.5), ball(3, 0.6, 0.5, 0.5)}), axis_view(), {});
  EXPECT_EQ(view.n_blended[4][4].item<int>(), 1);  // 0.0039 < 1/255 = 0.003922
  EXPECT_FALSE(view.contributes[0].item<bool>());

  const DenseView above = dense_render(leaves_of({ball(2, 0.4, 0.004, 0.5)}), axis_view(), {});
  EXPECT_NEAR(at(above.alpha, {4, 4}), 0.004, 1e-12);
  EXPECT_EQ(at(above.alpha, {4, 5}), 0.0);  // 0.004 exp(-0.5 / 4.3) = 0.0036
}

TEST(DenseReference, CullsNearerThanTheNearPlane) {
  RenderSettings settings;
  settings.near_plane = 1.5f;
  const DenseView view =
      dense_render(leaves_of({ball(1.49, 1, 0.5, 1), ball(1.51, 1, 0.25, 1)}), axis_view(), settings);
  EXPECT_NEAR(at(view.alpha, {4, 4}), 0.25, 1e-12);
  EXPECT_EQ(view.radii[0].item<int>(), 0);
  EXPECT_GT(view.radii[1].item<int>(), 0);
}

TEST(DenseReference, CutsTheSquareAtTiles) {
  // Radius 3 * sqrt(1.3) -> 4 about column 4.5: columns 0.5 to 8.5, tiles of 4 from floor(0.125) to ceil(2.125) - 1.
  // About row 1: rows -3 to 5, tiles of 3 from the first to ceil(5 / 3) - 1 = 1, rows 0 to 5.
  RenderSettings settings;
  settings.culling = Culling::kSquare;
  settings.tile = TileShape{4, 3};
  const GaussianTensors leaves = leaves_of({{{0, -0.36, 1}, {0.1, 0.1, 0.1}, {1, 0, 0, 0}, 0.98, 0.5}});
  PinholeView camera = axis_view();
  camera.cy = 4.6f;
  const DenseView view = dense_render(leaves, camera, settings);
  const DenseView whole = dense_render(leaves, camera, {});
  EXPECT_EQ(view.radii[0].item<int>(), 4);
  EXPECT_TRUE(test::same(view.alpha.slice(0, 0, 6), whole.alpha.slice(0, 0, 6)));
  EXPECT_EQ(at(view.alpha.slice(0, 6, 9).sum(), {}), 0.0);

  // If it is a little larger, the tail with alpha >= 1/255 reaches a row that the square does not.
  settings.tile = TileShape{1, 1};
  const GaussianTensors tail = leaves_of({{{0, 0, 1}, {0.1, 0.1, 0.1}, {1, 0, 0, 0}, 0.98, 0.5}});
  const DenseView cut = dense_render(tail, axis_view(), settings);
  EXPECT_TRUE(test::same(cut.alpha, dense_render(tail, axis_view(), {}).alpha));  // 4 px > 3.33 sigma = 3.8 px
}

TEST(DenseReference, ShBasisIsOrthonormal) {
  // Gauss-Legendre in z, exact to degree 7, times 8 even steps around. This integrates every product up to degree 6.
  const std::array<double, 4> nodes{-0.8611363115940526, -0.3399810435848563, 0.3399810435848563, 0.8611363115940526};
  const std::array<double, 4> weights{0.3478548451374538, 0.6521451548625461, 0.6521451548625461, 0.3478548451374538};
  std::vector<double> directions, areas;
  for (int i = 0; i < 4; ++i) {
    for (int step = 0; step < 8; ++step) {
      const double phi = 2 * M_PI * step / 8, r = std::sqrt(1 - nodes[i] * nodes[i]);
      directions.insert(directions.end(), {r * std::cos(phi), r * std::sin(phi), nodes[i]});
      areas.push_back(weights[i] * 2 * M_PI / 8);
    }
  }
  const torch::Tensor basis = dense_sh_basis(torch::tensor(directions, torch::kFloat64).view({-1, 3}), 3);
  const torch::Tensor gram = torch::matmul((basis * torch::tensor(areas, torch::kFloat64).unsqueeze(1)).t(), basis);
  EXPECT_TRUE(within(gram, torch::eye(16, torch::kFloat64), 1e-14));
}

TEST(DenseReference, OrdersAndSignsTheShBasisAsTheFieldDoes) {
  const double s = 1 / std::sqrt(3.0);
  const torch::Tensor basis = dense_sh_basis(torch::tensor({{s, s, s}}, torch::kFloat64), 3)[0];
  EXPECT_NEAR(at(basis, {1}), -kShDegree1 * s, 1e-12);
  EXPECT_NEAR(at(basis, {2}), kShDegree1 * s, 1e-12);
  EXPECT_NEAR(at(basis, {3}), -kShDegree1 * s, 1e-12);
  EXPECT_NEAR(at(basis, {4}), 1.0925484305920792 / 3, 1e-12);
  EXPECT_NEAR(at(basis, {5}), -1.0925484305920792 / 3, 1e-12);
  EXPECT_NEAR(at(basis, {6}), 0.0, 1e-12);
  EXPECT_NEAR(at(basis, {7}), -1.0925484305920792 / 3, 1e-12);
  EXPECT_NEAR(at(basis, {9}), -0.5900435899266435 * 2 * s / 3, 1e-12);
  EXPECT_NEAR(at(basis, {10}), 2.890611442640554 * s / 3, 1e-12);
  EXPECT_NEAR(at(basis, {11}), -0.4570457994658 * 2 * s / 3, 1e-10);
  EXPECT_NEAR(at(basis, {12}), 0.3731763325901154 * -4 * s / 3, 1e-12);
  EXPECT_NEAR(at(basis, {13}), -0.4570457994658 * 2 * s / 3, 1e-10);
  EXPECT_NEAR(at(basis, {14}), 0.0, 1e-12);
  EXPECT_NEAR(at(basis, {15}), -0.5900435899266435 * -2 * s / 3, 1e-12);
  const torch::Tensor other = dense_sh_basis(torch::tensor({{0.6, 0.0, 0.8}}, torch::kFloat64), 3)[0];
  EXPECT_NEAR(at(other, {6}), 0.31539156525252005 * (2 * 0.64 - 0.36), 1e-12);
  EXPECT_NEAR(at(other, {8}), 0.5462742152960396 * 0.36, 1e-12);
  EXPECT_NEAR(at(other, {14}), 1.445305721320277 * 0.8 * 0.36, 1e-12);
}

TEST(DenseReference, SeesColoursAlongTheRayFromTheCameraCentre) {
  const GaussianTensors leaves = leaves_of({{{0.3, 0.4, 0}, {1, 1, 1}, {1, 0, 0, 0}, 0.5, 0.5}});
  leaves.shN.detach()[0][2][1] = 0.7;  // shares memory with the leaf
  PinholeView camera = axis_view();
  camera.translation = {0, 0, 2};
  camera.center = {0, 0, -2};
  RenderSettings settings;
  settings.sh_degree = 1;
  const DenseView view = dense_render(leaves, camera, settings);
  const double x = 0.3 / std::sqrt(0.09 + 0.16 + 4);
  const double alpha = at(view.alpha, {6, 6});
  EXPECT_NEAR(at(view.color, {6, 6, 1}), alpha * (0.5 - kShDegree1 * x * 0.7), 1e-9);
  EXPECT_NEAR(at(view.color, {6, 6, 0}), alpha * 0.5, 1e-12);

  settings.sh_degree = 0;
  EXPECT_NEAR(at(dense_render(leaves, camera, settings).color, {6, 6, 1}), alpha * 0.5, 1e-12);
}

TEST(DenseReference, ClampsColoursAtZeroAndTheirGradientToo) {
  const GaussianTensors leaves = leaves_of({ball(2, 0.4, 0.6, -0.2), ball(3, 0.4, 0.6, 0.7)});
  const DenseView view = dense_render(leaves, axis_view(), {});
  EXPECT_NEAR(at(view.color, {4, 4, 0}), 0.4 * 0.6 * 0.7, 1e-12);
  RenderedViewGrad grad;
  grad.color = torch::ones({9, 9, 3});
  const torch::Tensor sh0 = dense_gradients(leaves, view, grad).parameters.sh0;
  EXPECT_EQ(sh0[0].abs().sum().item<double>(), 0.0);
  EXPECT_GT(sh0[1].abs().sum().item<double>(), 0.0);
}

TEST(DenseReference, MarksPixelsNearADecision) {
  const double near_cutoff = (1.0 + 2e-6) / 255.0;
  const DenseView view = dense_render(leaves_of({ball(2, 0.4, near_cutoff, 0.5)}), axis_view(), {});
  EXPECT_TRUE(view.near_decision[4][4].item<bool>());
  EXPECT_EQ(view.near_decision.sum().item<int>(), 1);

  // Two Gaussians at the cap leave 1e-4 up to rounding, and the third is behind the stop.
  std::vector<Row> rows{ball(2, 50, 0.9999, 0.5), ball(3, 50, 0.9999, 0.5), ball(4, 0.4, near_cutoff, 0.5)};
  EXPECT_TRUE(dense_render(leaves_of(rows), axis_view(), {}).near_decision.all().item<bool>());
  rows[1].opacity = 0.9;
  rows[2].opacity = 0.95;
  EXPECT_FALSE(dense_render(leaves_of(rows), axis_view(), {}).near_decision.any().item<bool>());
}

double loss_of(const DenseView& view, const RenderedViewGrad& grad) {
  return ((view.color * grad.color).sum() + (view.depth * grad.depth).sum() + (view.alpha * grad.alpha).sum())
      .item<double>();
}

std::vector<double> values_of(const torch::Tensor& tensor) {
  const torch::Tensor flat = tensor.detach().contiguous();
  return {flat.data_ptr<double>(), flat.data_ptr<double>() + flat.numel()};
}

/// Compares the gradient with respect to each group with finite differences.
void expect_gradients_of(const TestScene& scene) {
  const RenderSettings settings = settings_of(scene);
  const RenderedViewGrad grad = uneven_grad(scene.view);
  const GaussianTensors leaves = to_dense_leaves(scene.gaussians);
  const DenseView view = dense_render(leaves, scene.view, settings);
  ASSERT_TRUE(view.hazards.empty());
  ASSERT_FALSE(view.near_decision.any().item<bool>());
  const DenseGradients found = dense_gradients(leaves, view, grad);

  for (std::size_t group = 0; group < GaussianTensors::kNames.size(); ++group) {
    SCOPED_TRACE(GaussianTensors::kNames[group]);
    const torch::NoGradGuard no_grad;
    GaussianTensors moved = leaves;
    const auto value = [&](const std::vector<double>& x) {
      *moved.all()[group] = torch::tensor(x, torch::kFloat64).view_as(*leaves.all()[group]);
      return loss_of(dense_render(moved, scene.view, settings), grad);
    };
    const std::vector<double> numeric = numeric_gradient(value, values_of(*leaves.all()[group]));
    EXPECT_TRUE(gradients_agree(values_of(*found.parameters.all()[group]), numeric, 1e-8));
  }
}

TEST(DenseReference, GradientsAgreeWithFiniteDifferences) {
  expect_gradients_of(smooth_scene());
}

TEST(DenseReference, GradientsAgreeWithFiniteDifferencesWhereTheProjectionIsClamped) {
  expect_gradients_of(clamped_scene());
}

TEST(DenseReference, GradientsByProjectedCentresAddUpToThatByThePrincipalPoint) {
  const TestScene scene = smooth_scene();
  const RenderSettings settings = settings_of(scene);
  const RenderedViewGrad grad = uneven_grad(scene.view);
  const GaussianTensors leaves = to_dense_leaves(scene.gaussians);
  const torch::Tensor found = dense_gradients(leaves, dense_render(leaves, scene.view, settings), grad).means2d.sum(0);

  // The steps are powers of two, so that the float intrinsics move by exactly that.
  const auto value = [&](const std::vector<double>& center) {
    PinholeView moved = scene.view;
    moved.cx = static_cast<float>(center[0]);
    moved.cy = static_cast<float>(center[1]);
    return loss_of(dense_render(leaves, moved, settings), grad);
  };
  const auto slope = [&](int axis, double h) {
    std::vector<double> above{scene.view.cx, scene.view.cy}, below = above;
    above[static_cast<std::size_t>(axis)] += h;
    below[static_cast<std::size_t>(axis)] -= h;
    return (value(above) - value(below)) / (2 * h);
  };
  for (int axis = 0; axis < 2; ++axis) {
    const double numeric = (4 * slope(axis, 0x1p-9) - slope(axis, 0x1p-8)) / 3;
    EXPECT_NEAR(found[axis].item<double>(), numeric, 1e-8 * found.norm().item<double>());
  }
}

TEST(TestScenes, StayClearOfDecisionsThatConcernMoreThanAPixel) {
  for (const TestSceneRow& row : test_scenes()) {
    SCOPED_TRACE(row.name);
    const TestScene scene = row.build();
    const GaussianTensors leaves = to_dense_leaves(scene.gaussians);
    RenderSettings settings = settings_of(scene);
    settings.culling = Culling::kSquare;
    const torch::NoGradGuard no_grad;
    const DenseView view = dense_render(leaves, scene.view, settings);
    EXPECT_TRUE(view.hazards.empty()) << view.hazards.front();
    EXPECT_LE(view.near_decision.sum().item<double>(), 0.01 * static_cast<double>(view.near_decision.numel()));
  }
}

TEST(TestScenes, ReachWhatTheyAreNamedFor) {
  const auto render = [](const TestScene& scene) {
    const torch::NoGradGuard no_grad;
    return dense_render(to_dense_leaves(scene.gaussians), scene.view, settings_of(scene));
  };
  EXPECT_FALSE(render(behind_the_camera()).contributes.any().item<bool>());
  EXPECT_EQ(render(thirty_three_in_one_tile()).contributes.sum().item<int>(), 33);
  EXPECT_EQ(render(thirty_three_in_one_tile()).alpha.slice(0, 16, 24).slice(1, 16, 32).count_nonzero().item<int>(),
            render(thirty_three_in_one_tile()).alpha.count_nonzero().item<int>());
  const DenseView crowded = render(ten_thousand_in_one_tile());
  EXPECT_EQ(crowded.alpha.slice(1, 16).count_nonzero().item<int>(), 0);
  EXPECT_GT(crowded.n_blended.max().item<int>(), 500);
  EXPECT_GT((crowded.alpha > 0.9998).sum().item<int>(), 20) << "some of its pixels end early";
  EXPECT_EQ(render(opaque_front_layer()).contributes.sum().item<int>(), 3);
  const torch::Tensor remaining = 1 - render(saturated_pixels()).alpha;
  EXPECT_GT((remaining < 1e-2).sum().item<int>(), 500);
  EXPECT_GT((remaining > 0.1).sum().item<int>(), 10);
  EXPECT_GT((render(at_the_cap()).alpha >= 0.99).sum().item<int>(), 100);
  const torch::Tensor faint = render(near_the_cutoff()).contributes;
  EXPECT_TRUE(faint.any().item<bool>() && !faint.all().item<bool>());
  EXPECT_TRUE((render(far_outside_the_field_of_view()).contributes.sum() > 15).item<bool>());
}

}  // namespace
}  // namespace b3dgs::test
