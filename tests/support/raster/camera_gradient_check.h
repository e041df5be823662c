// Compares the gradient with respect to the camera's pose with the dense reference, for any view class with the
// interface of CpuView (cpu_harness.h).
#pragma once

#include "support/raster/reference_check.h"

namespace b3dgs::test {

/// Sizes of the terms of the gradient, which are the contributions of the Gaussians.
struct CameraTerms {
  double rotation = 0, translation = 0;

  CameraTerms(const TestScene& scene, const Reference& reference) {
    const GaussianTensors& grads = reference.gradients.parameters;
    const Vec3f& c = scene.view.center;
    const torch::Tensor center = torch::tensor({double{c.x}, double{c.y}, double{c.z}}, torch::kFloat64);
    const torch::Tensor means = row_norms(grads.means);
    translation = means.sum().item<double>();
    rotation = (means * row_norms(reference.leaves.means.detach() - center)).sum().item<double>() +
               (row_norms(grads.quats) * row_norms(reference.leaves.quats.detach())).sum().item<double>();
  }
};

/// Compares the gradients of a scene's camera, without anti-aliasing, with it, and with it and 3D filters.
template <class FoundView>
void expect_same_camera_gradients(TestScene scene) {
  constexpr double kRounding = 2e-5;  // of the terms
  for (const auto& [antialiasing, with_filters] :
       {std::pair(false, false), std::pair(true, false), std::pair(true, true)}) {
    SCOPED_TRACE(testing::Message() << "antialiasing " << antialiasing << ", filters " << with_filters);
    if (with_filters) add_filters(scene);
    RenderSettings settings = settings_of(scene);
    settings.antialiasing = antialiasing;
    settings.camera_gradient = true;
    const Reference reference(scene, settings);
    const torch::Tensor motion = torch::zeros({kCameraGradients}, torch::kFloat64).requires_grad_(true);
    const DenseView moved = dense_render(reference.leaves, scene.view, settings, motion);
    const torch::Tensor expected = dense_motion_gradient(motion, moved, reference.grad);
    FoundView view(scene, settings);
    view.backward(reference.grad);
    const CameraTerms terms(scene, reference);
    const torch::Tensor allowed = kRounding * torch::tensor({terms.rotation, terms.rotation, terms.rotation,
                                                             terms.translation, terms.translation, terms.translation},
                                                            torch::kFloat64);
    EXPECT_TRUE(within(view.camera_gradient(), expected, allowed))
        << "found " << view.camera_gradient() << "\nexpected " << expected;
  }
}

}  // namespace b3dgs::test
