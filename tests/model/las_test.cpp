#include "model/formats/las.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>

#include "support/files.h"
#include "support/temp_dir.h"

namespace b3dgs {
namespace {

using test::read_bytes;
using test::TempDir;

/// Reads a value at a byte of the file, as ASPRS's specification of LAS 1.2 places it.
template <class T>
T at(const std::string& bytes, std::size_t place) {
  T value{};
  EXPECT_LE(place + sizeof value, bytes.size());
  std::memcpy(&value, bytes.data() + place, sizeof value);
  return value;
}

SplatCloud two_gaussians() {
  SplatCloud cloud;
  cloud.sh_degree = 0;
  cloud.frame = {{576682.924, 5188164.0227, 198.5}, 2};
  cloud.means = {0, 0, 0, 10.5f, -20.25f, 3};
  cloud.log_scales.assign(6, -3);
  cloud.quats = {1, 0, 0, 0, 1, 0, 0, 0};
  cloud.logit_opacities = {0, 20};
  cloud.sh0 = {0, 0, 0, 100, -100, 0};  // grey; red 1, green 0, blue 0.5
  return cloud;
}

TEST(Las, HasPositionsColoursAndTheCoordinateSystem) {
  const TempDir folder;
  write_las(folder / "points.las", two_gaussians(), 32615);
  const std::string bytes = read_bytes(folder / "points.las");
  EXPECT_EQ(bytes.substr(0, 4), "LASF");
  EXPECT_EQ(at<std::uint8_t>(bytes, 24), 1);
  EXPECT_EQ(at<std::uint8_t>(bytes, 25), 2);
  ASSERT_EQ(at<std::uint16_t>(bytes, 94), 227) << "bytes of the header";
  const auto first = at<std::uint32_t>(bytes, 96);
  EXPECT_EQ(at<std::uint32_t>(bytes, 100), 1u) << "records";
  EXPECT_EQ(at<std::uint8_t>(bytes, 104), 2) << "point format";
  const auto length = at<std::uint16_t>(bytes, 105);
  ASSERT_EQ(length, 26);
  ASSERT_EQ(at<std::uint32_t>(bytes, 107), 2u) << "points";
  EXPECT_EQ(at<std::uint32_t>(bytes, 111), 2u) << "first returns";
  ASSERT_EQ(bytes.size(), first + 2 * length);
  // The GeoTIFF keys: projected, EPSG code, metres.
  EXPECT_STREQ(bytes.substr(227 + 2, 16).c_str(), "LASF_Projection");
  EXPECT_EQ(at<std::uint16_t>(bytes, 227 + 18), 34735);
  const std::size_t keys = 227 + 54;
  ASSERT_EQ(at<std::uint16_t>(bytes, 227 + 20), first - keys);
  ASSERT_EQ(at<std::uint16_t>(bytes, keys + 6), (first - keys) / 8 - 1) << "number of keys";
  EXPECT_EQ(at<std::uint16_t>(bytes, keys + 16), 3072);
  EXPECT_EQ(at<std::uint16_t>(bytes, keys + 22), 32615);
  const double expected[2][3] = {{576682.924, 5188164.0227, 198.5}, {576703.924, 5188123.5227, 204.5}};
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const auto step = at<double>(bytes, 131 + 8 * axis), offset = at<double>(bytes, 155 + 8 * axis);
    EXPECT_EQ(step, 0.001);
    for (std::size_t i = 0; i < 2; ++i) {
      EXPECT_NEAR(offset + step * at<std::int32_t>(bytes, first + i * length + 4 * axis), expected[i][axis], 0.00051);
    }
    const auto [low, high] = std::minmax(expected[0][axis], expected[1][axis]);
    EXPECT_NEAR(at<double>(bytes, 179 + 16 * axis), high, 1e-6);
    EXPECT_NEAR(at<double>(bytes, 187 + 16 * axis), low, 1e-6);
  }
  EXPECT_NEAR(at<std::uint16_t>(bytes, first + 12), 32768, 1) << "intensity of opacity 0.5";
  for (std::size_t c = 0; c < 3; ++c) EXPECT_NEAR(at<std::uint16_t>(bytes, first + 20 + 2 * c), 32768, 1);
  EXPECT_EQ(at<std::uint16_t>(bytes, first + length + 20), 65535);
  EXPECT_EQ(at<std::uint16_t>(bytes, first + length + 22), 0);
}

TEST(Las, WithoutACoordinateSystemThereIsNoRecord) {
  const TempDir folder;
  write_las(folder / "points.las", two_gaussians(), 0);
  const std::string bytes = read_bytes(folder / "points.las");
  EXPECT_EQ(at<std::uint32_t>(bytes, 96), 227u);
  EXPECT_EQ(at<std::uint32_t>(bytes, 100), 0u);
}

TEST(Las, FarPointsAreStoredInLargerSteps) {
  SplatCloud cloud = two_gaussians();
  cloud.means[3] = 4e6f;
  const TempDir folder;
  write_las(folder / "points.las", cloud, 32615);
  const std::string bytes = read_bytes(folder / "points.las");
  const auto step = at<double>(bytes, 131), offset = at<double>(bytes, 155);
  const auto first = at<std::uint32_t>(bytes, 96);
  EXPECT_NEAR(offset + step * at<std::int32_t>(bytes, first + 26), 576682.924 + 8e6, step);
}

}  // namespace
}  // namespace b3dgs
