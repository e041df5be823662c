// PLY files, read as Gaussians and as points.
#include <cmath>
#include <optional>

#include "fuzz/fuzz_target.h"
#include "model/formats/ply.h"

namespace b3dgs::fuzz {
namespace {

void check_splats(const SplatCloud& cloud) {
  const auto n = static_cast<std::size_t>(cloud.size());
  B3DGS_CHECK(cloud.sh_degree >= 0 && cloud.sh_degree <= 3, "SH degree ", cloud.sh_degree);
  B3DGS_CHECK(cloud.means.size() == 3 * n && cloud.log_scales.size() == 3 * n && cloud.quats.size() == 4 * n &&
                  cloud.sh0.size() == 3 * n &&
                  cloud.shN.size() == 3 * n * static_cast<std::size_t>(sh_coefficient_count(cloud.sh_degree) - 1),
              "the arrays of ", n, " Gaussians differ in length");
  for (const std::vector<float>* values :
       {&cloud.means, &cloud.log_scales, &cloud.quats, &cloud.logit_opacities, &cloud.sh0, &cloud.shN}) {
    for (const float value : *values) B3DGS_CHECK(std::isfinite(value), "expected a finite value, found ", value);
  }
}

void check_points(const PointCloud& points) {
  B3DGS_CHECK(points.positions.size() == points.colors.size(), "positions and colours differ in length");
  for (const float value : points.positions)
    B3DGS_CHECK(std::isfinite(value), "expected a finite value, found ", value);
}

}  // namespace

void read_input(std::string_view bytes) {
  std::optional<InputError> refused;
  try {
    FileReader file("a.ply", bytes);
    check_splats(read_splat_ply(file));
  } catch (const InputError& error) {
    refused = error;
  }
  FileReader file("a.ply", bytes);
  PointCloud points;
  try {
    points = read_point_ply(file);
  } catch (const InputError&) {
    if (refused) throw;
    return;
  }
  check_points(points);
}

}  // namespace b3dgs::fuzz
