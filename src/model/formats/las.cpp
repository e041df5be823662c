#include "model/formats/las.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <string>

#include "core/files/atomic_file.h"
#include "core/text.h"
#include "raster/math/sh.h"

namespace b3dgs {
namespace {

/// Appends values without padding, little-endian.
struct Bytes {
  std::string bytes;

  template <class T>
  void put(T value) {
    bytes.append(reinterpret_cast<const char*>(&value), sizeof value);
  }
  void text(std::string text, std::size_t length) {
    text.resize(length, '\0');
    bytes += text;
  }
};

/// Returns a record with the GeoTIFF keys of the coordinate system.
std::string projection_record(int epsg) {
  constexpr std::uint16_t kMetre = 9001, kProjected = 1;
  // Keys 1024, 3072, 3076 and 4099: the type of the system, the system, and its units across and up.
  const std::array<std::array<std::uint16_t, 4>, 5> keys{{{1, 1, 0, 4},
                                                          {1024, 0, 1, kProjected},
                                                          {3072, 0, 1, static_cast<std::uint16_t>(epsg)},
                                                          {3076, 0, 1, kMetre},
                                                          {4099, 0, 1, kMetre}}};
  constexpr std::uint16_t kGeoKeyDirectory = 34735;
  Bytes record;
  record.put(std::uint16_t{0});
  record.text("LASF_Projection", 16);
  record.put(kGeoKeyDirectory);
  record.put(static_cast<std::uint16_t>(sizeof keys));
  record.text("coordinate system", 32);
  for (const auto& key : keys) {
    for (const std::uint16_t value : key) record.put(value);
  }
  return record.bytes;
}

}  // namespace

bool is_las(const std::filesystem::path& path) {
  return lower_case(path.extension().string()) == ".las";
}

void write_las(const std::filesystem::path& path, const SplatCloud& cloud, int epsg) {
  constexpr std::uint16_t kHeaderBytes = 227, kPointBytes = 26;
  constexpr double kMostSteps = 2e9, kColorMax = 65535;
  const auto n = static_cast<std::size_t>(cloud.size());
  std::array<double, 3> low{}, high{}, offset{};
  for (std::size_t i = 0; i < n; ++i) {
    const std::array<double, 3> at = cloud.frame.to_world(&cloud.means[3 * i]);
    for (std::size_t axis = 0; axis < 3; ++axis) {
      low[axis] = i == 0 ? at[axis] : std::min(low[axis], at[axis]);
      high[axis] = i == 0 ? at[axis] : std::max(high[axis], at[axis]);
    }
  }
  double step = 0.001;  // m
  for (std::size_t axis = 0; axis < 3; ++axis) {
    offset[axis] = std::floor(low[axis]);
    while (high[axis] - offset[axis] > kMostSteps * step) step *= 10;
  }
  const std::string projection = epsg > 0 ? projection_record(epsg) : "";
  Bytes header;
  header.text("LASF", 4);
  header.put(std::uint32_t{0});  // file source, global encoding
  header.text("", 16);           // project ID
  header.put(std::uint8_t{1});
  header.put(std::uint8_t{2});
  header.text("Balanced3DGS", 32);
  header.text("b3dgs", 32);
  header.put(std::uint32_t{0});  // day and year, left out so that equal models are equal files
  header.put(kHeaderBytes);
  header.put(static_cast<std::uint32_t>(kHeaderBytes + projection.size()));
  header.put(std::uint32_t{epsg > 0 ? 1u : 0u});  // records before the points
  header.put(std::uint8_t{2});                    // point format
  header.put(kPointBytes);
  header.put(static_cast<std::uint32_t>(n));
  for (const std::size_t of_return : {n, std::size_t{0}, std::size_t{0}, std::size_t{0}, std::size_t{0}}) {
    header.put(static_cast<std::uint32_t>(of_return));
  }
  for (int axis = 0; axis < 3; ++axis) header.put(step);
  for (const double value : offset) header.put(value);
  for (std::size_t axis = 0; axis < 3; ++axis) {
    header.put(high[axis]);
    header.put(low[axis]);
  }
  AtomicFile file(path);
  file.write(header.bytes + projection);
  Bytes block;
  for (std::size_t i = 0; i < n; ++i) {
    const std::array<double, 3> at = cloud.frame.to_world(&cloud.means[3 * i]);
    for (std::size_t axis = 0; axis < 3; ++axis) {
      block.put(static_cast<std::int32_t>(std::lround((at[axis] - offset[axis]) / step)));
    }
    const double opacity = 1 / (1 + std::exp(-static_cast<double>(cloud.logit_opacities[i])));
    block.put(static_cast<std::uint16_t>(std::lround(kColorMax * opacity)));  // intensity
    block.put(std::uint8_t{0b001001});                                        // the first of one return
    block.text("", 5);                                                        // class, scan angle, user data, source
    for (std::size_t c = 0; c < 3; ++c) {
      const double color = std::clamp(0.5 + kSh0 * static_cast<double>(cloud.sh0[3 * i + c]), 0.0, 1.0);
      block.put(static_cast<std::uint16_t>(std::lround(kColorMax * color)));
    }
    constexpr std::size_t kBlockBytes = 1 << 20;
    if (block.bytes.size() < kBlockBytes && i + 1 < n) continue;
    file.write(block.bytes);
    block.bytes.clear();
  }
  file.commit();
}

}  // namespace b3dgs
