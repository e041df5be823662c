#include "model/formats/splat_formats.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "core/check.h"
#include "core/text.h"
#include "raster/math/antialiasing.h"
#include "raster/math/opacity.h"

namespace b3dgs {

namespace fs = std::filesystem;

std::optional<SplatFormat> splat_format(const fs::path& path) {
  const std::string extension = lower_case(path.extension().string());
  if (extension == ".ply") return SplatFormat::kPly;
  if (extension == ".spz") return SplatFormat::kSpz;
  return std::nullopt;
}

SplatCloud read_splats(const fs::path& path) {
  return splat_format(path) == SplatFormat::kSpz ? read_spz(path) : read_splat_ply(path);
}

bool holds_splats(const fs::path& path) {
  return splat_format(path) == SplatFormat::kSpz || is_splat_ply(path);
}

void write_splats(const fs::path& path, const SplatCloud& cloud) {
  const std::optional<SplatFormat> format = splat_format(path);
  if (!format) {
    input_error(path.string(), ": unknown file format for Gaussians; expected a file name that ends in .ply or .spz");
  }
  *format == SplatFormat::kSpz ? write_spz(path, cloud) : write_splat_ply(path, cloud);
}

std::vector<double> world_positions(const SplatCloud& cloud, std::size_t at_most) {
  const std::size_t step = 3 * std::max<std::size_t>(1, cloud.means.size() / 3 / at_most);
  std::vector<double> positions;
  for (std::size_t i = 0; i < cloud.means.size(); i += step) {
    const std::array<double, 3> position = cloud.frame.to_world(&cloud.means[i]);
    positions.insert(positions.end(), position.begin(), position.end());
  }
  return positions;
}

void include_filters(const std::vector<float>& filters, SplatCloud& cloud) {
  constexpr double kMinOpacity = 1e-12;  // the logits of this and of 1 - this are finite
  B3DGS_CHECK(static_cast<std::int64_t>(filters.size()) == cloud.size(), filters.size(), " filters of ", cloud.size(),
              " Gaussians");
  for (std::size_t i = 0; i < filters.size(); ++i) {
    float* const log_scales = cloud.log_scales.data() + 3 * i;
    const Smoothed<double> smoothed =
        smooth(Vec3<double>{log_scales[0], log_scales[1], log_scales[2]}, static_cast<double>(filters[i]));
    log_scales[0] = static_cast<float>(smoothed.log_scales.x);
    log_scales[1] = static_cast<float>(smoothed.log_scales.y);
    log_scales[2] = static_cast<float>(smoothed.log_scales.z);
    const double opacity =
        std::exp(smoothed.log_opacity_ratio) / (1 + std::exp(-static_cast<double>(cloud.logit_opacities[i])));
    cloud.logit_opacities[i] = logit(std::clamp(opacity, kMinOpacity, 1 - kMinOpacity));
  }
}

void change_frame(const CoordinateFrame& to, SplatCloud& cloud) {
  if (cloud.frame == to) return;
  for (std::size_t i = 0; i < cloud.means.size(); i += 3) {
    const std::array<double, 3> world = cloud.frame.to_world(&cloud.means[i]), local = to.from_world(world.data());
    for (std::size_t axis = 0; axis < 3; ++axis) cloud.means[i + axis] = static_cast<float>(local[axis]);
  }
  const double log_ratio = std::log(cloud.frame.unit / to.unit);
  for (float& scale : cloud.log_scales) scale = static_cast<float>(scale + log_ratio);
  cloud.frame = to;
}

}  // namespace b3dgs
