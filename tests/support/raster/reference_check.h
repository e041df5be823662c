// Compares a rasterizer with the dense reference, with the tolerance of each result. Works on any view class with the
// interface of CpuView (cpu_harness.h).
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <vector>

#include "support/approx.h"
#include "support/raster/boundary_band.h"
#include "support/raster/cpu_harness.h"

namespace b3dgs::test {

inline constexpr std::pair<Culling, const char*> kCullings[] = {{Culling::kEllipse, "ellipse"},
                                                                {Culling::kSquare, "square"}};

inline constexpr KernelFamily kFamilies[] = {KernelFamily::kPaper, KernelFamily::kOwn};

/// Returns the kernels of a family. Its tiles determine visibility and, with Culling::kSquare, the image.
inline std::vector<KernelRow> kernels_of(KernelFamily family) {
  std::vector<KernelRow> rows;
  for (const KernelRow& row : kForwardKernels) {
    if (family_of(row.kernel) == family) rows.push_back(row);
  }
  return rows;
}

/// A scene rendered by the dense reference, with gradients.
struct Reference {
  GaussianTensors leaves;
  DenseView view;
  RenderedViewGrad grad;  // 0 at pixels near a decision, so that gradients must agree everywhere
  DenseGradients gradients;

  Reference(const TestScene& scene, const RenderSettings& settings) : leaves(to_dense_leaves(scene.gaussians)) {
    view = dense_render(leaves, scene.view, settings);
    grad = uneven_grad(scene.view, view.near_decision);
    gradients = dense_gradients(leaves, view, grad);
  }
};

inline double largest(const torch::Tensor& tensor, double at_least) {
  return tensor.numel() == 0 ? at_least : std::max(at_least, tensor.detach().abs().max().item<double>());
}

template <class FoundView>
void expect_same_image(const FoundView& found, const DenseView& expected) {
  const torch::Tensor& doubtful = expected.near_decision;
  EXPECT_TRUE(images_agree(found.color, expected.color, doubtful, largest(expected.color, 1))) << "colour";
  EXPECT_TRUE(images_agree(found.depth, expected.depth, doubtful, largest(expected.depth, 1))) << "depth";
  EXPECT_TRUE(images_agree(found.alpha, expected.alpha, doubtful, 1)) << "alpha";
  const torch::Tensor settled = torch::logical_not(doubtful);
  EXPECT_TRUE(within(found.last_gaussians() * settled, expected.last_gaussians * settled, 0)) << "last Gaussian";
}

/// Compares the gradients of one group, as a whole and row by row. `size` [N] is the norm of each row. A row may also
/// differ by a fraction of the largest row, because it is a sum over pixels of terms that may cancel. Each term can be
/// as large as in the largest row and is rounded accordingly. If even the largest row is the result of cancellation,
/// `terms` [N] is the size of the terms, which float rounds in the 7th digit.
inline testing::AssertionResult same_gradient(const torch::Tensor& found, const torch::Tensor& expected,
                                              const torch::Tensor& size, const torch::Tensor& terms) {
  constexpr double kRelative = 1e-4, kFloor = 5e-5, kRounding = 1e-6;
  if (expected.numel() == 0) return within(found, expected, 0);
  std::vector<std::int64_t> column(static_cast<std::size_t>(expected.dim()), 1);
  column[0] = expected.size(0);
  const torch::Tensor allowed = (kRelative * size + kFloor * size.max() + kRounding * terms).view(column);
  testing::AssertionResult entries = within(found, expected, allowed);
  const double error = (found.to(torch::kFloat64) - expected).norm().item<double>();
  const double whole = size.norm().item<double>();
  if (error <= kRelative * whole + kRounding * terms.norm().item<double>()) return entries;
  return testing::AssertionFailure() << "off by " << error << " of " << whole << "; " << entries.message();
}

inline torch::Tensor row_norms(const torch::Tensor& tensor) {
  return tensor.numel() == 0 ? torch::zeros({tensor.size(0)}, torch::kFloat64)
                             : tensor.reshape({tensor.size(0), -1}).norm(2, 1);
}

/// The size of each row's terms: the root of the sum of their squares over the pixels. Random signs of the pixel
/// gradients give that on average, and this averages several draws. Scales and rotation share the gradient with respect
/// to one matrix, so the rounding error of a needle's rotation also appears in its scales.
struct TermSizes {
  std::vector<torch::Tensor> parameters;  // [N] each
  torch::Tensor means2d;                  // [N]

  TermSizes(const Reference& reference, const RenderedViewGrad& grad) {
    constexpr int kDraws = 4;
    torch::Generator generator = torch::make_generator<torch::CPUGeneratorImpl>(1);
    const auto with_signs = [&](const torch::Tensor& t) {
      return t.defined() ? t * (2 * torch::randint(2, t.sizes(), generator, t.options()) - 1) : t;
    };
    const auto add = [](torch::Tensor& sum, const torch::Tensor& rows) {
      const torch::Tensor square = rows.square() / kDraws;
      sum = sum.defined() ? sum + square : square;
    };
    parameters.resize(GaussianTensors::kNames.size());
    for (int draw = 0; draw < kDraws; ++draw) {
      const RenderedViewGrad drawn{with_signs(grad.color), with_signs(grad.depth), with_signs(grad.alpha)};
      const DenseGradients gradients = dense_gradients(reference.leaves, reference.view, drawn);
      for (std::size_t i = 0; i < parameters.size(); ++i) add(parameters[i], row_norms(*gradients.parameters.all()[i]));
      add(means2d, row_norms(gradients.means2d));
    }
    for (torch::Tensor& sum : parameters) sum = sum.sqrt();
    means2d = means2d.sqrt();
    constexpr std::size_t kLogScales = 1, kQuats = 2;
    static_assert(GaussianTensors::kNames[kLogScales] == std::string_view("log_scales"));
    const torch::Tensor whole = row_norms(dense_gradients(reference.leaves, reference.view, grad).parameters.quats);
    const torch::Tensor rotation =
        torch::maximum(parameters[kQuats], whole) * row_norms(reference.leaves.quats.detach());
    parameters[kLogScales] = parameters[kLogScales] + rotation;
  }
};

/// `terms`, if given, is the size of the terms that cancel in `expected`.
inline void expect_same_gradients(const DenseGradients& found, const Reference& reference,
                                  const DenseGradients& expected, const TermSizes* terms = nullptr) {
  const torch::Tensor idle = torch::logical_not(reference.view.contributes).nonzero().squeeze(1);
  for (std::size_t i = 0; i < GaussianTensors::kNames.size(); ++i) {
    SCOPED_TRACE(GaussianTensors::kNames[i]);
    const torch::Tensor& group = *found.parameters.all()[i];
    torch::Tensor size = row_norms(*expected.parameters.all()[i]);
    if (group.is_same(found.parameters.quats)) {
      // Rotating a sphere changes nothing, so its rotation gradient is rounding error of the scale gradient's terms.
      size = size + row_norms(expected.parameters.log_scales) / row_norms(reference.leaves.quats.detach());
    }
    const torch::Tensor rounded = terms != nullptr ? terms->parameters[i] : torch::zeros_like(size);
    EXPECT_TRUE(same_gradient(group, *expected.parameters.all()[i], size, rounded));
    const torch::Tensor nothing = group.index_select(0, idle);
    EXPECT_TRUE(within(nothing, torch::zeros_like(nothing), 0)) << "gradients of Gaussians that no pixel blends";
  }
  const torch::Tensor size = row_norms(expected.means2d);
  const torch::Tensor rounded = terms != nullptr ? terms->means2d : torch::zeros_like(size);
  EXPECT_TRUE(same_gradient(found.means2d, expected.means2d, size, rounded)) << "means2d";
}

/// Compares which Gaussians are visible, and their radii.
inline void expect_same_radii(const torch::Tensor& found, const DenseView& expected) {
  const torch::Tensor seen = found > 0;
  const auto count = [](const torch::Tensor& which) { return which.sum().item<std::int64_t>(); };
  EXPECT_EQ(count(expected.contributes & ~seen), 0) << "Gaussians in the image have no radius";
  EXPECT_EQ(count(expected.seen & ~seen), 0) << "Gaussians that touch a tile are not seen";
  EXPECT_EQ(count(seen & ~expected.seen_nearly), 0) << "Gaussians that touch no tile are seen";
  EXPECT_LE(count(expected.seen_nearly & ~expected.seen), 2 + found.numel() / 50)
      << "too many Gaussians are near a decision";
  EXPECT_TRUE(within(found, expected.radii * seen, 0)) << "radii";
}

/// Compares anti-aliased views of a scene, with and without 3D filters, and their gradients.
template <class FoundView>
void expect_same_antialiased_views(TestScene scene) {
  // Filters only with ellipses, because the squares of some larger splats end on a tile border within rounding.
  for (const auto& [culling, with_filters] :
       {std::pair(Culling::kEllipse, false), std::pair(Culling::kSquare, false), std::pair(Culling::kEllipse, true)}) {
    if (with_filters) add_filters(scene);
    SCOPED_TRACE(testing::Message() << "square: " << (culling == Culling::kSquare) << ", filters: " << with_filters);
    RenderSettings settings = settings_of(scene);
    settings.antialiasing = true;
    settings.culling = culling;
    const Reference reference(scene, settings);
    ASSERT_TRUE(reference.view.hazards.empty())
        << "scene cannot check a float rasterizer: " << reference.view.hazards.front();
    FoundView view(scene, settings);
    expect_same_image(view, reference.view);
    expect_same_radii(view.radii(), reference.view);
    expect_same_gradients(view.backward(reference.grad), reference, reference.gradients);
    if (testing::Test::HasFailure()) return;  // one failing case is enough
  }
}

/// Compares the inverse depth of a scene and its gradients, for all kernels.
template <class FoundView>
void expect_same_inverse_depth(const TestScene& scene) {
  RenderSettings settings = settings_of(scene);
  settings.inverse_depth = true;
  const Reference reference(scene, settings);
  ASSERT_TRUE(reference.view.hazards.empty())
      << "scene cannot check a float rasterizer: " << reference.view.hazards.front();
  const RenderedViewGrad only_depth{{}, reference.grad.depth, {}};
  const DenseGradients expected = dense_gradients(reference.leaves, reference.view, only_depth);
  const TermSizes terms(reference, only_depth);
  for (const KernelRow& row : kForwardKernels) {
    SCOPED_TRACE(row.name);
    settings.kernel = row.kernel;
    FoundView view(scene, settings);
    expect_same_image(view, reference.view);
    expect_same_gradients(view.backward(only_depth), reference, expected, &terms);
    expect_same_gradients(view.backward(reference.grad), reference, reference.gradients);
    if (testing::Test::HasFailure()) return;  // one failing kernel is enough
  }
}

/// Compares the sets of Gaussians that two rasterizers see, [N] radii each. They must be equal, except for Gaussians so
/// close to a threshold that float rounding decides.
inline void expect_same_seen(const torch::Tensor& found, const torch::Tensor& other, const DenseView& reference) {
  const torch::Tensor in_doubt = reference.seen_nearly & ~reference.seen;
  const torch::Tensor differs = ((found > 0) != (other > 0)) & ~in_doubt;
  EXPECT_EQ(differs.sum().item<std::int64_t>(), 0) << "Gaussians are seen by only one of the two";
  EXPECT_TRUE(within(found * (other > 0), other * (found > 0), 0)) << "radii of Gaussians that both see";
}

}  // namespace b3dgs::test
