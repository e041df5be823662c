// Small scenes that together cover every branch of the rasterizer and are small enough for the dense reference. They
// are the same on every machine.
#pragma once

#include <ostream>
#include <string>
#include <vector>

#include "raster/args.h"
#include "raster/torch/rasterizer.h"

namespace b3dgs::test {

/// Gaussians and one view of them. Depths are either exactly equal or differ enough to have the same order in float.
struct TestScene {
  GaussianTensors gaussians;  // float, CPU
  CameraView view{};
  Vec3f background{0.1f, 0.3f, 0.6f};
  int sh_degree = 0;  // rendered; shN may be allocated for a higher degree
};

/// Makes spheres of various colours, SH degree 0. @param means [N, 3] @param scales, opacities [N]
GaussianTensors make_spheres(const torch::Tensor& means, const torch::Tensor& scales, const torch::Tensor& opacities);

TestScene empty_scene();                    // no Gaussians
TestScene one_splat();                      // in the middle of a tile
TestScene splat_on_tile_corner();           // centre on the common corner of four tiles
TestScene behind_the_camera();              // nothing is visible: behind the camera, at it, or before the near plane
TestScene around_the_near_plane();          // some nearer, some farther
TestScene thirty_three_in_one_tile();       // one more than the lanes of a warp; no other tile is reached
TestScene ten_thousand_in_one_tile();       // one long list, the other tiles empty
TestScene ends_along_a_long_list();         // thousands of faint splats, and a few opaque ones in between
TestScene opaque_front_layer();             // every pixel finishes in front of most Gaussians
TestScene saturated_pixels();               // pixels finish at different depths
TestScene odd_image_size();                 // 37 x 29: tiles are cut off at two edges
TestScene one_pixel_image();                // 1 x 1
TestScene anisotropic_cloud();              // 300 Gaussians, SH degree 3, rotated camera
TestScene off_centre_principal_point();     // and different focal lengths
TestScene far_outside_the_field_of_view();  // huge splats for which the Jacobian is clamped
TestScene needles();                        // long and thin, at all angles
TestScene tiny_splats();                    // much smaller than a pixel: the blur determines their size
TestScene negative_colors();                // clamped in some channels
TestScene unnormalised_quaternions();       // lengths from 1e-3 to 1e3
TestScene equal_depths();                   // ordered by index
TestScene at_the_cap();                     // alpha 0.99 inside, less outside
TestScene near_the_cutoff();                // opacities just above 1/255, and below
TestScene degree_below_maximum();           // SH degree 1 of 3
TestScene no_higher_degrees();              // shN has no rows
TestScene distorted_lens();                 // FULL_OPENCV, with tangential and thin-prism terms
TestScene fov_lens();                       // the three perspective lenses with their own radial functions
TestScene division_lens();                  //
TestScene eucm_lens();                      //
TestScene fisheye_lens();                   // 200 degrees; Gaussians all around the camera, and some that surround it
TestScene prism_fisheye_lens();             // 120 degrees, all terms

/// A panorama, with Gaussians across its seam and beyond the latitude of linearisation. None is wider than half the
/// image.
TestScene panorama();

/// All pixels are far from all thresholds: alphas from 0.02 to 0.7, no stop, no clamp. For finite differences.
TestScene smooth_scene();

/// 30 000 Gaussians, a third of them behind the camera, which is enough work for several threads. Too many for the
/// dense reference, and not in test_scenes().
TestScene large_cloud();

struct TestSceneRow {
  const char* name;
  TestScene (*build)();
};

inline void PrintTo(const TestSceneRow& row, std::ostream* out) {
  *out << row.name;
}

/// All scenes above except large_cloud().
const std::vector<TestSceneRow>& test_scenes();

}  // namespace b3dgs::test
