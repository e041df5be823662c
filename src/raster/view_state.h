// What the CPU and the CUDA rasterizer both keep of a forward pass for the passes that follow it.
#pragma once

#include <cstdint>

#include "core/check.h"
#include "raster/args.h"
#include "raster/stages.h"

namespace b3dgs {

struct ViewState {
  PinholeView view{};
  int sh_degree = 0;
  bool antialiasing = false;
  bool camera_gradient = false, has_camera_gradient = false;
  bool inverse_depth = false;
  TileGrid grid{};
  std::int64_t n_gaussians = -1;  // -1: no view, or of forward_splats()
  std::int64_t n_rows = -1;       // of forward_splats(); -1: no view, or of forward()
  std::int64_t n_splats = 0;
  Vec3f background{};
  ImageArrays rendered{};
  StageRecorder* stages = nullptr;

  bool has_view() const { return n_gaussians >= 0 || n_rows >= 0; }
  void forget_view() { n_gaussians = n_rows = -1; }

  /// Before projection. Until all passes have succeeded, there is no view.
  void begin_view(const PinholeView& next_view, const TileGrid& next_grid, const RenderSettings& settings) {
    forget_view();
    view = next_view;
    grid = next_grid;
    sh_degree = settings.sh_degree;
    antialiasing = settings.antialiasing;
    stages = settings.stages;
    has_camera_gradient = false;
  }
  /// Before binning.
  void begin_drawing(const RenderSettings& settings, const ImageArrays& out) {
    background = settings.background;
    rendered = out;
    camera_gradient = settings.camera_gradient;
    inverse_depth = settings.inverse_depth;
  }
  /// @throws LogicError if the last forward() had another number of Gaussians
  void check_gaussians(const GaussianArrays& gaussians) const {
    B3DGS_CHECK(n_gaussians == gaussians.n_gaussians, "backward() with ", gaussians.n_gaussians,
                " Gaussians after a forward() with ", n_gaussians, " (-1: none)");
  }
};

}  // namespace b3dgs
