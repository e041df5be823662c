#include "model/formats/splat_formats.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "core/check.h"
#include "support/expect_error.h"
#include "support/files.h"
#include "support/formats/spz_content.h"
#include "support/same.h"
#include "support/temp_dir.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using test::fails_with;

// Half a step of each attribute, and a little for float arithmetic.
constexpr double kPositionBound = 0.5 / 4096 + 1e-6;
constexpr double kOpacityBound = 0.5 / 255 + 1e-6;
constexpr double kColorBound = 0.5 / 255 / 0.15 + 1e-6;
constexpr double kLogScaleBound = 0.5 / 16 + 1e-6;
constexpr double kShBound = 0.5 / 128 + 1e-6, kShBoundOf4Bits = 0.5 / 8 + 1e-6;
// Angles, rad. Three components are within e = 0.5 / 511 * sqrt(1/2); if all four are equal, the largest is within 3 e,
// the quaternion within sqrt(12) e, and the angle within twice that.
constexpr double kRotationBound = 0.0048;
constexpr double kOldRotationBound = 0.02;

double sigmoid(double x) {
  return 1 / (1 + std::exp(-x));
}

/// Returns a value between -1 and 1 that depends only on `i`.
float noise(std::size_t i) {
  const double x = std::sin(12.9898 * static_cast<double>(i) + 0.5) * 43758.5453;
  return static_cast<float>(2 * (x - std::floor(x)) - 1);
}

SplatCloud random_cloud(std::size_t n, int sh_degree) {
  SplatCloud cloud;
  cloud.sh_degree = sh_degree;
  const std::size_t n_rest = static_cast<std::size_t>(sh_coefficient_count(sh_degree)) - 1;
  std::size_t at = 0;
  const auto fill = [&](std::vector<float>& values, std::size_t count, float offset, float scale) {
    for (std::size_t i = 0; i < count; ++i) values.push_back(offset + scale * noise(at++));
  };
  fill(cloud.means, 3 * n, 0, 30);
  fill(cloud.log_scales, 3 * n, -3, 3);
  fill(cloud.quats, 4 * n, 0, 3);
  fill(cloud.logit_opacities, n, 0, 5);
  fill(cloud.sh0, 3 * n, 0, 1.7f);
  fill(cloud.shN, 3 * n_rest * n, 0, 0.9f);
  return cloud;
}

/// Returns the angle between the rotations of two quaternions, rad.
double angle_between(const float* a, const float* b) {
  double dot = 0, aa = 0, bb = 0;
  for (int i = 0; i < 4; ++i) {
    dot += static_cast<double>(a[i]) * b[i];
    aa += static_cast<double>(a[i]) * a[i];
    bb += static_cast<double>(b[i]) * b[i];
  }
  return 2 * std::acos(std::min(1.0, std::abs(dot) / std::sqrt(aa * bb)));
}

class Spz : public testing::Test {
 protected:
  fs::path store(const std::string& content) {
    const fs::path path = folder_ / "a.spz";
    test::write_bytes(path, test::gzip(content));
    return path;
  }
  fs::path store4(const std::string& file) {
    test::write_bytes(folder_ / "a4.spz", file);
    return folder_ / "a4.spz";
  }
  SplatCloud write_and_read(const SplatCloud& cloud) {
    write_spz(folder_ / "b.spz", cloud);
    return read_spz(folder_ / "b.spz");
  }
  testing::AssertionResult refuses(const fs::path& path, std::initializer_list<std::string> parts) {
    const auto result = fails_with<InputError>({path.string()}, [&] { read_spz(path); });
    if (!result) return result;
    return fails_with<InputError>(parts, [&] { read_spz(path); });
  }

  test::TempDir folder_;
};

TEST_F(Spz, ReadsWhatItWritesWithinTheStepsOfTheFormat) {
  for (const int degree : {0, 1, 2, 3}) {
    const SplatCloud cloud = random_cloud(5000, degree);  // more than a block
    const SplatCloud back = write_and_read(cloud);
    ASSERT_EQ(back.size(), cloud.size());
    ASSERT_EQ(back.sh_degree, degree);
    ASSERT_EQ(back.shN.size(), cloud.shN.size());
    EXPECT_FALSE(back.antialiased);
    for (std::size_t i = 0; i < 3 * 5000; ++i) {
      ASSERT_NEAR(back.means[i], cloud.means[i], kPositionBound) << i;
      ASSERT_NEAR(back.log_scales[i], cloud.log_scales[i], kLogScaleBound) << i;
      ASSERT_NEAR(back.sh0[i], cloud.sh0[i], kColorBound) << i;
    }
    for (std::size_t i = 0; i < 5000; ++i) {
      ASSERT_NEAR(sigmoid(back.logit_opacities[i]), sigmoid(cloud.logit_opacities[i]), kOpacityBound) << i;
      ASSERT_LT(angle_between(&back.quats[4 * i], &cloud.quats[4 * i]), kRotationBound) << i;
    }
    for (std::size_t i = 0; i < cloud.shN.size(); ++i) {
      ASSERT_NEAR(back.shN[i], cloud.shN[i], kShBound) << i;
    }
  }
}

TEST_F(Spz, FewerBitsOfShMakeSmallerFiles) {
  const SplatCloud cloud = random_cloud(2000, 3);
  write_spz(folder_ / "8.spz", cloud);
  write_spz(folder_ / "4.spz", cloud, 4);
  EXPECT_LT(fs::file_size(folder_ / "4.spz"), 0.75 * static_cast<double>(fs::file_size(folder_ / "8.spz")));
  const SplatCloud back = read_spz(folder_ / "4.spz");
  for (std::size_t i = 0; i < cloud.shN.size(); ++i) ASSERT_NEAR(back.shN[i], cloud.shN[i], kShBoundOf4Bits) << i;
}

TEST_F(Spz, WritesTheSameBytesAgain) {
  const SplatCloud cloud = random_cloud(300, 3);
  const SplatCloud once = write_and_read(cloud);
  const std::string first = test::read_bytes(folder_ / "b.spz");
  EXPECT_TRUE(test::same(first, test::read_bytes(folder_ / "b.spz")));
  const SplatCloud twice = write_and_read(once);
  EXPECT_EQ(twice.means, once.means);
  EXPECT_EQ(twice.log_scales, once.log_scales);
  EXPECT_EQ(twice.sh0, once.sh0);
  EXPECT_EQ(twice.shN, once.shN);
  EXPECT_EQ(twice.logit_opacities, once.logit_opacities);
}

TEST_F(Spz, KeepsTheFlagOfAntialiasing) {
  SplatCloud cloud = random_cloud(3, 0);
  cloud.antialiased = true;
  EXPECT_TRUE(write_and_read(cloud).antialiased);
}

TEST_F(Spz, HoldsNoGaussiansAtAll) {
  const SplatCloud back = write_and_read(SplatCloud{});
  EXPECT_EQ(back.size(), 0);
}

TEST_F(Spz, ClampsWhatTheFormatCannotHold) {
  SplatCloud cloud = random_cloud(2, 1);
  cloud.logit_opacities = {1000, -1000};
  cloud.log_scales = {100, -100, 0, 5.9f, -10, 0};
  cloud.shN[0] = 7;
  cloud.shN[2] = -7;
  const SplatCloud back = write_and_read(cloud);
  EXPECT_NEAR(sigmoid(back.logit_opacities[0]), 1, 0.001);
  EXPECT_NEAR(sigmoid(back.logit_opacities[1]), 0, 0.001);
  EXPECT_FLOAT_EQ(back.log_scales[0], 255.0f / 16 - 10);
  EXPECT_FLOAT_EQ(back.log_scales[1], -10);
  EXPECT_NEAR(back.shN[0], 1, 0.01);
  EXPECT_NEAR(back.shN[2], -1, 0.01);
}

TEST_F(Spz, ChoosesFractionalBitsThatFit) {
  SplatCloud cloud = random_cloud(10, 0);
  EXPECT_EQ(spz_fractional_bits(cloud), 12);
  EXPECT_EQ(spz_fractional_bits(SplatCloud{}), 12);
  cloud.means[4] = -3000;  // 12 bits hold +-2048
  EXPECT_EQ(spz_fractional_bits(cloud), 11);
  EXPECT_NEAR(write_and_read(cloud).means[4], -3000, 1e-3);
  cloud.means[4] = 8e6f;
  EXPECT_EQ(spz_fractional_bits(cloud), 0);
  EXPECT_NEAR(write_and_read(cloud).means[4], 8e6, 0.5);
  cloud.means[4] = 1e7f;
  EXPECT_TRUE(fails_with<InputError>({"1e+07", "8.38861e+06", "--crop"}, [&] { write_spz(folder_ / "c.spz", cloud); }));
  EXPECT_FALSE(fs::exists(folder_ / "c.spz"));
  // A metre is 1/1000 in this scene.
  cloud = random_cloud(10, 0);
  for (float& value : cloud.means) value *= 1e-3f;
  for (float& value : cloud.log_scales) value -= std::log(1000.0f);
  const int bits = spz_fractional_bits(cloud);
  EXPECT_GT(bits, 16);
  EXPECT_NEAR(write_and_read(cloud).means[4], cloud.means[4], std::ldexp(0.5, -bits));
}

// Bytes as described in the format, with x right, y up, z back.
TEST_F(Spz, ReadsBytesOfOtherPrograms) {
  std::string content = test::spz_header(3, 1, 1, 8, 1);
  const auto add = [&](std::initializer_list<int> bytes) {
    for (const int byte : bytes) content += static_cast<char>(byte);
  };
  add({0x80, 0x01, 0, 0x00, 0xfe, 0xff, 0, 1, 0});  // 1.5, -2, 1
  add({51});                                        // 0.2
  add({255, 0, 51});
  add({160, 144, 0});
  // Largest: w (3). x = 511 (+sqrt(1/2)), y = 0, z = 0: 90 degrees about x.
  const std::uint32_t quat = 3u << 30 | 511u << 20;
  for (int i = 0; i < 4; ++i) add({static_cast<int>(quat >> (8 * i) & 255)});
  add({192, 128, 128, 128, 64, 128, 128, 128, 0});
  const SplatCloud cloud = read_spz(store(content));
  EXPECT_TRUE(cloud.antialiased);
  EXPECT_EQ(cloud.means, (std::vector<float>{1.5f, 2, -1}));
  EXPECT_NEAR(sigmoid(cloud.logit_opacities[0]), 0.2, 1e-6);
  EXPECT_NEAR(cloud.sh0[0], 0.5 / 0.15, 1e-5);
  EXPECT_NEAR(cloud.sh0[1], -0.5 / 0.15, 1e-5);
  EXPECT_NEAR(cloud.sh0[2], -0.3 / 0.15, 1e-5);
  EXPECT_EQ(cloud.log_scales, (std::vector<float>{0, -1, -10}));
  const std::array<float, 4> quarter_turn{1, 1, 0, 0};
  EXPECT_LT(angle_between(cloud.quats.data(), quarter_turn.data()), 1e-3);
  // The coefficients of y, z, x; the first two change sign with their axes.
  const std::vector<float> sh{-0.5f, 0, 0, 0, 0.5f, 0, 0, 0, -1};
  for (std::size_t i = 0; i < sh.size(); ++i) EXPECT_EQ(cloud.shN[i], sh[i]) << i;
}

TEST_F(Spz, ReadsTheRotationsOfVersion2) {
  std::string content = test::spz_header(2, 1, 0);
  content += std::string(9 + 7, '\0');
  content += {'\x80', static_cast<char>(218), '\x80'};  // x = z = 0, y = 0.71: 90 degrees about y (up)
  const SplatCloud cloud = read_spz(store(content));
  const std::array<float, 4> quarter_turn{1, 0, -1, 0};  // y is down in memory
  EXPECT_LT(angle_between(cloud.quats.data(), quarter_turn.data()), kOldRotationBound);
}

TEST_F(Spz, ReadsThePositionsOfVersion1) {
  std::string content = test::spz_header(1, 1, 0, 0);
  content += std::string("\x00\x3e\x00\xc1\x01\x00", 6);  // 1.5, -2.5, 2^-24
  content += std::string(7 + 3, '\x80');
  const SplatCloud cloud = read_spz(store(content));
  EXPECT_EQ(cloud.means, (std::vector<float>{1.5f, 2.5f, -std::ldexp(1.0f, -24)}));
  content[16 + 1] = '\x7c';  // infinite
  EXPECT_TRUE(refuses(store(content), {"Gaussian 0", "finite position"}));
}

TEST_F(Spz, RefusesFilesOfOtherKinds) {
  EXPECT_TRUE(fails_with<InputError>({"none.spz", "No such file"}, [&] { read_spz(folder_ / "none.spz"); }));
  test::write_bytes(folder_ / "a.spz", "");
  EXPECT_TRUE(refuses(folder_ / "a.spz", {"truncated"}));
  test::write_bytes(folder_ / "a.spz", "ply\nformat ascii 1.0\n");
  EXPECT_TRUE(refuses(folder_ / "a.spz", {"damaged"}));
  EXPECT_TRUE(refuses(store("XGSP" + test::spz_content(3, 1, 0).substr(4)), {"NGSP"}));
  EXPECT_TRUE(refuses(store(test::spz_header(9, 0, 0)), {"version 1 to 4", "found 9"}));
  EXPECT_TRUE(refuses(store(test::spz_header(4, 0, 0)), {"version 4 inside gzip"}));
  EXPECT_TRUE(refuses(store4(test::spz_header(3, 0, 0) + std::string(16, '\0')), {"version 3 outside of gzip"}));
  EXPECT_TRUE(refuses(store4(test::spz_header(5, 0, 0) + std::string(16, '\0')), {"version 1 to 4", "found 5"}));
  EXPECT_TRUE(refuses(store(test::spz_header(3, 0, 4)), {"SH degree 0 to 3", "found 4"}));
  EXPECT_TRUE(refuses(store(test::spz_header(3, 0, 0, 24)), {"fractional bits", "found 24"}));
}

TEST_F(Spz, RefusesTruncatedAndDamagedFiles) {
  write_spz(folder_ / "whole.spz", random_cloud(40, 1));
  const std::string whole = test::read_bytes(folder_ / "whole.spz");
  for (std::size_t size = 0; size < whole.size(); size += 7) {
    test::write_bytes(folder_ / "a.spz", whole.substr(0, size));
    ASSERT_TRUE(refuses(folder_ / "a.spz", {"truncated"})) << size;
  }
  std::string changed = whole;
  changed[changed.size() / 2] = static_cast<char>(changed[changed.size() / 2] ^ 0x10);
  test::write_bytes(folder_ / "a.spz", changed);
  EXPECT_TRUE(refuses(folder_ / "a.spz", {"damaged"}));
  test::write_bytes(folder_ / "a.spz", whole + "x");
  EXPECT_TRUE(refuses(folder_ / "a.spz", {"more bytes"}));
  EXPECT_TRUE(refuses(store(test::spz_content(3, 5, 1) + "x"), {"found more"}));
  std::string missing = test::spz_content(3, 5, 1);
  missing.pop_back();
  EXPECT_TRUE(refuses(store(missing), {"ends 1 or more bytes early"}));
}

TEST_F(Spz, ReadsVersion4) {
  for (const std::uint8_t degree : {0, 3}) {
    std::string content = test::spz_content(3, 7, degree);
    for (std::size_t i = 16; i < content.size(); ++i) content[i] = static_cast<char>(31 * i);
    content[14] = 1;
    const SplatCloud old = read_spz(store(content)), cloud = read_spz(store4(test::spz4_file(content)));
    EXPECT_EQ(cloud.size(), 7);
    EXPECT_TRUE(cloud.antialiased);
    EXPECT_EQ(cloud.means, old.means);
    EXPECT_EQ(cloud.quats, old.quats);
    EXPECT_EQ(cloud.log_scales, old.log_scales);
    EXPECT_EQ(cloud.logit_opacities, old.logit_opacities);
    EXPECT_EQ(cloud.sh0, old.sh0);
    EXPECT_EQ(cloud.shN, old.shN);
  }
}

TEST_F(Spz, WritesTheSameGaussiansAsVersion4) {
  for (const int degree : {0, 3}) {
    SplatCloud cloud = random_cloud(5000, degree);
    cloud.antialiased = true;
    const SplatCloud old = write_and_read(cloud);
    write_spz(folder_ / "4.spz", cloud, kSpzShBits, 4);
    const std::string bytes = test::read_bytes(folder_ / "4.spz");
    EXPECT_EQ(bytes.substr(0, 5), "NGSP\4");
    EXPECT_EQ(bytes[15], degree > 0 ? 6 : 5);
    const SplatCloud back = read_spz(folder_ / "4.spz");
    EXPECT_TRUE(back.antialiased);
    EXPECT_EQ(back.means, old.means);
    EXPECT_EQ(back.quats, old.quats);
    EXPECT_EQ(back.log_scales, old.log_scales);
    EXPECT_EQ(back.logit_opacities, old.logit_opacities);
    EXPECT_EQ(back.sh0, old.sh0);
    EXPECT_EQ(back.shN, old.shN);
  }
  write_spz(folder_ / "empty.spz", SplatCloud{}, kSpzShBits, 4);
  EXPECT_EQ(read_spz(folder_ / "empty.spz").size(), 0);
}

TEST_F(Spz, RefusesTruncatedAndDamagedFilesOfVersion4) {
  const std::string whole = test::spz4_file(test::spz_content(3, 400, 1));
  ASSERT_EQ(read_spz(store4(whole)).size(), 400);
  for (std::size_t size = 4; size < whole.size(); ++size) {
    ASSERT_TRUE(refuses(store4(whole.substr(0, size)), {"truncated"})) << size;
  }
  EXPECT_TRUE(refuses(store4(whole + "x"), {"more bytes"}));
  const auto with = [&](std::size_t at, char byte) {
    std::string changed = whole;
    changed[at] = byte;
    return store4(changed);
  };
  EXPECT_TRUE(refuses(with(15, 4), {"expected 6 streams", "found 4"}));
  EXPECT_TRUE(refuses(with(15, 7), {"expected 6 streams", "found 7"}));
  EXPECT_TRUE(refuses(with(16, 31), {"a table at 31"}));
  EXPECT_TRUE(refuses(with(32 + 8, 1), {"stream 0", "expected 3600 bytes"}));
  EXPECT_TRUE(refuses(with(32 + 6 * 16, 'x'), {"damaged"}));  // Zstandard's magic number
  std::string missing = test::spz4_file(test::spz_content(3, 399, 1));
  missing.replace(0, 32 + 6 * 16, whole.substr(0, 32 + 6 * 16));
  EXPECT_TRUE(fails_with<InputError>({"a4.spz"}, [&] { read_spz(store4(missing)); }));
  std::string bomb = test::spz4_file(test::spz_content(3, 200000, 0));
  EXPECT_TRUE(refuses(store4(bomb), {"200000 Gaussians", "damaged"}));
}

TEST_F(Spz, RefusesOtherAxes) {
  const std::string content = test::spz_content(3, 5, 1);
  const std::string other("\2\0\xbe\xad\4\0\0\0abcd", 12);
  const auto axes = [](char system) { return std::string("\3\0\xbe\xad\4\0\0\0", 8) + system + std::string(3, '\0'); };
  EXPECT_EQ(read_spz(store4(test::spz4_file(content, other + axes(4)))).size(), 5);
  EXPECT_TRUE(refuses(store4(test::spz4_file(content, other + axes(6))), {"coordinate system 6", "splat-transform"}));
  // A record that claims more bytes than there are is the last.
  EXPECT_EQ(read_spz(store4(test::spz4_file(content, std::string(12, '\xff') + axes(6)))).size(), 5);
}

TEST_F(Spz, ReadsPastExtensionsThatItsFlagsAnnounce) {
  std::string content = test::spz_content(3, 5, 1);
  content[14] = 2;
  EXPECT_EQ(read_spz(store(content + std::string(1000, 'x'))).size(), 5);
  EXPECT_TRUE(refuses(store(content + std::string(3 << 20, 'x')), {"found more"}));
}

TEST_F(Spz, RefusesCountsThatTheFileCannotHold) {
  EXPECT_TRUE(refuses(store(test::spz_header(3, std::numeric_limits<std::uint32_t>::max(), 3)),
                      {"4294967295 Gaussians", "damaged"}));
  // 20 MB of zeros from 20 kB.
  EXPECT_TRUE(refuses(store(test::spz_header(3, 1000000, 0) + std::string(20000000, '\0')), {"1000000 Gaussians"}));
}

}  // namespace
}  // namespace b3dgs
