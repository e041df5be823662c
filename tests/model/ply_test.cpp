#include "model/formats/splat_formats.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "core/check.h"
#include "support/expect_error.h"
#include "support/files.h"
#include "support/same.h"
#include "support/temp_dir.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using test::bytes_of;
using test::fails_with;
using test::read_bytes;
using test::TempDir;
using test::write_bytes;

// Every value is different, so that misplaced ones are detected.
SplatCloud numbered_cloud(int n, int degree) {
  SplatCloud cloud;
  cloud.sh_degree = degree;
  float next = 1;
  const auto fill = [&](std::vector<float>& values, int width) {
    values.resize(static_cast<std::size_t>(n) * width);
    for (float& value : values) value = next++;
  };
  fill(cloud.means, 3);
  fill(cloud.log_scales, 3);
  fill(cloud.quats, 4);
  fill(cloud.logit_opacities, 1);
  fill(cloud.sh0, 3);
  fill(cloud.shN, 3 * (sh_coefficient_count(degree) - 1));
  return cloud;
}

void expect_equal(const SplatCloud& a, const SplatCloud& b) {
  EXPECT_EQ(a.sh_degree, b.sh_degree);
  EXPECT_EQ(a.means, b.means);
  EXPECT_EQ(a.log_scales, b.log_scales);
  EXPECT_EQ(a.quats, b.quats);
  EXPECT_EQ(a.logit_opacities, b.logit_opacities);
  EXPECT_EQ(a.sh0, b.sh0);
  EXPECT_EQ(a.shN, b.shN);
}

const std::vector<std::string> kDegree0{"x",       "y",       "z",       "f_dc_0", "f_dc_1", "f_dc_2", "opacity",
                                        "scale_0", "scale_1", "scale_2", "rot_0",  "rot_1",  "rot_2",  "rot_3"};

std::string header(const std::string& format, int count, const std::vector<std::string>& names,
                   const std::string& type = "float") {
  std::string text = "ply\nformat " + format + " 1.0\nelement vertex " + std::to_string(count) + "\n";
  for (const std::string& name : names) text += "property " + type + " " + name + "\n";
  return text + "end_header\n";
}

class SplatPly : public testing::Test {
 protected:
  fs::path store(const std::string& bytes) {
    write_bytes(folder_ / "a.ply", bytes);
    return folder_ / "a.ply";
  }
  testing::AssertionResult refuses(const std::string& bytes, std::initializer_list<std::string> parts) {
    const fs::path path = store(bytes);
    const auto result = fails_with<InputError>({path.string()}, [&] { read_splat_ply(path); });
    return result ? fails_with<InputError>(parts, [&] { read_splat_ply(path); }) : result;
  }
  TempDir folder_;
};

TEST_F(SplatPly, WrittenInBlocksIsTheSameFile) {
  const SplatCloud whole = numbered_cloud(7, 2);
  write_splat_ply(folder_ / "whole.ply", whole);
  SplatPlyWriter writer(folder_ / "blocks.ply", 7, 2, /*antialiased=*/false, {});
  for (const auto& [begin, end] : {std::pair(0, 3), std::pair(3, 3), std::pair(3, 7)}) {
    SplatCloud rows;
    rows.sh_degree = 2;
    const auto take = [first = begin, last = end](const std::vector<float>& from, std::vector<float>& to, int width) {
      to.assign(from.begin() + first * width, from.begin() + last * width);
    };
    take(whole.means, rows.means, 3);
    take(whole.log_scales, rows.log_scales, 3);
    take(whole.quats, rows.quats, 4);
    take(whole.logit_opacities, rows.logit_opacities, 1);
    take(whole.sh0, rows.sh0, 3);
    take(whole.shN, rows.shN, 24);
    writer.append(rows);
  }
  EXPECT_FALSE(fs::exists(folder_ / "blocks.ply"));
  writer.commit();
  EXPECT_TRUE(test::same(read_bytes(folder_ / "blocks.ply"), read_bytes(folder_ / "whole.ply")));
  SplatPlyWriter short_one(folder_ / "short.ply", 7, 2, /*antialiased=*/false, {});
  EXPECT_THROW(short_one.commit(), LogicError);
}

TEST_F(SplatPly, CoordinatesAreThoseOfTheWorld) {
  for (const CoordinateFrame& frame : {CoordinateFrame{{1e6, -2e6, 5}, 0.25}, CoordinateFrame{{3, 4, 5}, 2}}) {
    SplatCloud cloud = numbered_cloud(7, 1);
    cloud.frame = frame;
    write_splat_ply(folder_ / "a.ply", cloud);
    const bool is_far = frame.is_far();
    const std::string bytes = read_bytes(folder_ / "a.ply");
    EXPECT_EQ(bytes.find("property double z") != std::string::npos, is_far);
    SplatCloud back = read_splat_ply(folder_ / "a.ply");
    EXPECT_EQ(back.frame != CoordinateFrame{}, is_far);
    const std::vector<double> before = world_positions(cloud), after = world_positions(back);
    ASSERT_EQ(after.size(), before.size());
    for (std::size_t i = 0; i < before.size(); ++i) EXPECT_NEAR(after[i], before[i], 1e-5);
    change_frame(frame, back);
    for (std::size_t i = 0; i < before.size(); ++i) {
      EXPECT_NEAR(back.means[i], cloud.means[i], 1e-5);
      EXPECT_NEAR(back.log_scales[i], cloud.log_scales[i], 1e-5);
    }
    EXPECT_EQ(back.quats, cloud.quats);
    EXPECT_EQ(back.shN, cloud.shN);
    EXPECT_EQ(back.logit_opacities, cloud.logit_opacities);
  }
}

TEST_F(SplatPly, SaysWhetherGaussiansAreAntialiased) {
  SplatCloud cloud = numbered_cloud(3, 1);
  write_splat_ply(folder_ / "plain.ply", cloud);
  EXPECT_FALSE(read_splat_ply(folder_ / "plain.ply").antialiased);
  cloud.antialiased = true;
  write_splat_ply(folder_ / "mip.ply", cloud);
  EXPECT_TRUE(read_splat_ply(folder_ / "mip.ply").antialiased);
  const std::string comment = "comment SplatRenderMode: mip\n", bytes = read_bytes(folder_ / "mip.ply");
  EXPECT_NE(bytes.find("\n" + comment), std::string::npos);
  std::string without = bytes;
  without.erase(without.find(comment), comment.size());
  EXPECT_TRUE(test::same(without, read_bytes(folder_ / "plain.ply")));
}

TEST_F(SplatPly, HasTheDocumentedHeaderAndBytes) {
  SplatCloud cloud;
  cloud.sh_degree = 3;
  cloud.means = {1, 2, 3};
  cloud.sh0 = {4, 5, 6};
  for (int k = 0; k < 15; ++k) {
    for (int c = 0; c < 3; ++c) cloud.shN.push_back(static_cast<float>(100 * c + k));
  }
  cloud.logit_opacities = {-7};
  cloud.log_scales = {8, 9, 10};
  cloud.quats = {11, 12, 13, 14};
  write_splat_ply(folder_ / "a.ply", cloud);

  std::string expected = "ply\nformat binary_little_endian 1.0\nelement vertex 1\n";
  for (const char* name : {"x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"}) {
    expected += std::string("property float ") + name + "\n";
  }
  for (int i = 0; i < 45; ++i) expected += "property float f_rest_" + std::to_string(i) + "\n";
  for (const char* name : {"opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"}) {
    expected += std::string("property float ") + name + "\n";
  }
  expected += "end_header\n";
  const std::size_t header_bytes = expected.size();
  for (const float value : {1.f, 2.f, 3.f, 0.f, 0.f, 0.f, 4.f, 5.f, 6.f}) expected += bytes_of(value);
  for (int c = 0; c < 3; ++c) {  // 15 of red, 15 of green, 15 of blue
    for (int k = 0; k < 15; ++k) expected += bytes_of(static_cast<float>(100 * c + k));
  }
  for (const float value : {-7.f, 8.f, 9.f, 10.f, 11.f, 12.f, 13.f, 14.f}) expected += bytes_of(value);
  ASSERT_EQ(expected.size() - header_bytes, 248u);
  EXPECT_TRUE(test::same(read_bytes(folder_ / "a.ply"), expected));
}

TEST_F(SplatPly, ReadsBackEveryDegree) {
  for (int degree = 0; degree <= 3; ++degree) {
    for (const int n : {0, 1, 5000}) {  // 5000: more than one block
      const SplatCloud cloud = numbered_cloud(n, degree);
      write_splat_ply(folder_ / "a.ply", cloud);
      expect_equal(read_splat_ply(folder_ / "a.ply"), cloud);
    }
  }
}

TEST_F(SplatPly, ReadsByNameInAnyOrderAndType) {
  const std::string text =
      "ply\r\nformat binary_little_endian 1.0\ncomment made by hand\nelement camera 2\nproperty list uchar int a\n"
      "property short b\nelement vertex 1\nproperty double rot_3\nproperty uchar extra\nproperty float rot_2\n"
      "property float rot_1\nproperty float rot_0\nproperty short opacity\nproperty float scale_2\n"
      "property list uchar float more\nproperty float scale_1\nproperty float scale_0\nproperty float f_dc_2\n"
      "property float f_dc_1\nproperty float f_dc_0\nproperty float z\nproperty float y\nproperty float64 x\n"
      "element face 1\nproperty uchar f\nend_header\n";
  std::string data = bytes_of<std::uint8_t>(2) + bytes_of(1) + bytes_of(2) + bytes_of<std::int16_t>(3) +
                     bytes_of<std::uint8_t>(0) + bytes_of<std::int16_t>(4);
  data += bytes_of(4.0) + bytes_of<std::uint8_t>(99) + bytes_of(3.f) + bytes_of(2.f) + bytes_of(1.f) +
          bytes_of<std::int16_t>(-5) + bytes_of(8.f) + bytes_of<std::uint8_t>(1) + bytes_of(0.f) + bytes_of(7.f) +
          bytes_of(6.f);
  for (const float value : {11.f, 10.f, 9.f, 14.f, 13.f}) data += bytes_of(value);
  data += bytes_of(12.0) + "f";
  const SplatCloud cloud = read_splat_ply(store(text + data));
  EXPECT_EQ(cloud.sh_degree, 0);
  EXPECT_EQ(cloud.quats, (std::vector<float>{1, 2, 3, 4}));
  EXPECT_EQ(cloud.logit_opacities, std::vector<float>{-5});
  EXPECT_EQ(cloud.log_scales, (std::vector<float>{6, 7, 8}));
  EXPECT_EQ(cloud.sh0, (std::vector<float>{9, 10, 11}));
  EXPECT_EQ(cloud.means, (std::vector<float>{12, 13, 14}));
}

TEST_F(SplatPly, ReadsBigEndianAndAscii) {
  std::string big = header("binary_big_endian", 2, kDegree0), ascii = header("ascii", 2, kDegree0);
  for (int row = 0; row < 2; ++row) {
    for (int i = 0; i < 14; ++i) {
      const float value = static_cast<float>(i + 14 * row) + 0.5f;
      std::string bytes = bytes_of(value);
      std::reverse(bytes.begin(), bytes.end());
      big += bytes;
      ascii += std::to_string(value) + (i == 13 ? "\n" : "  ");
    }
  }
  const SplatCloud from_big = read_splat_ply(store(big)), from_ascii = read_splat_ply(store(ascii));
  EXPECT_EQ(from_big.means, (std::vector<float>{0.5, 1.5, 2.5, 14.5, 15.5, 16.5}));
  EXPECT_EQ(from_big.quats, (std::vector<float>{10.5, 11.5, 12.5, 13.5, 24.5, 25.5, 26.5, 27.5}));
  expect_equal(from_big, from_ascii);
}

TEST_F(SplatPly, RejectsOtherFiles) {
  EXPECT_TRUE(refuses("", {"not a PLY file"}));
  EXPECT_TRUE(refuses("PK\x03\x04", {"not a PLY file"}));
  EXPECT_TRUE(refuses("ply\nformat binary_little_endian 1.0\nelement vertex 3\n", {"end_header"}));
  EXPECT_TRUE(refuses("ply\nelement vertex 0\nproperty float x\nend_header\n", {"expected a line \"format\""}));
  EXPECT_TRUE(refuses("ply\nformat zip 1.0\nend_header\n", {":2:", "zip"}));
  EXPECT_TRUE(refuses("ply\nformat ascii 1.0\nelement vertex many\n", {":3:", "\"many\""}));
  EXPECT_TRUE(refuses("ply\nformat ascii 1.0\nelement vertex 1\nproperty half x\n", {":4:", "\"half\""}));
  EXPECT_TRUE(refuses("ply\nformat ascii 1.0\nelement face 1\nproperty int a\nend_header\n1\n",
                      {"expected an element \"vertex\"", "face"}));
  EXPECT_TRUE(fails_with<InputError>({"none.ply", "No such file"}, [&] { read_splat_ply(folder_ / "none.ply"); }));
}

TEST_F(SplatPly, NamesFormatsOfOtherPrograms) {
  std::vector<std::string> flat = kDegree0;
  flat.erase(std::find(flat.begin(), flat.end(), "scale_2"));
  const fs::path two_scales = folder_ / "2dgs.ply", packed = folder_ / "packed.ply";
  write_bytes(two_scales, header("binary_little_endian", 0, flat));
  write_bytes(packed, header("binary_little_endian", 0,
                             {"packed_position", "packed_rotation", "packed_scale", "packed_color"}, "uint"));
  for (const auto& read :
       {+[](const fs::path& path) { is_splat_ply(path); }, +[](const fs::path& path) { read_splat_ply(path); },
        +[](const fs::path& path) { read_point_ply(path); }}) {
    EXPECT_TRUE(fails_with<InputError>({"2dgs.ply", "2D Gaussian Splatting"}, [&] { read(two_scales); }));
    EXPECT_TRUE(fails_with<InputError>({"packed.ply", "SuperSplat", "export it as PLY"}, [&] { read(packed); }));
  }
}

TEST_F(SplatPly, NamesTheMissingProperty) {
  std::vector<std::string> names = kDegree0;
  names.erase(names.begin() + 12);
  EXPECT_TRUE(refuses(header("binary_little_endian", 0, names), {"no property rot_2"}));
}

TEST_F(SplatPly, RejectsANumberOfRestCoefficientsOfNoDegree) {
  std::vector<std::string> names = kDegree0;
  for (int i = 0; i < 10; ++i) names.push_back("f_rest_" + std::to_string(i));
  EXPECT_TRUE(refuses(header("binary_little_endian", 0, names), {"0, 9, 24 or 45", "found 10"}));
  names.pop_back();
  names.back() = "f_rest_9";  // nine of them, but f_rest_8 is missing
  EXPECT_TRUE(refuses(header("binary_little_endian", 0, names), {"no property f_rest_8"}));
}

TEST_F(SplatPly, RejectsCountsThatTheFileCannotHold) {
  const std::string row(14 * 4, '\x3f');
  EXPECT_TRUE(refuses(header("binary_little_endian", 2000000000, kDegree0) + row,
                      {"2000000000 rows of element vertex", "found 56 bytes"}));
  EXPECT_TRUE(refuses(header("binary_little_endian", 2, kDegree0) + row + row.substr(1), {"2 rows of element vertex"}));
  EXPECT_TRUE(refuses(header("binary_little_endian", 1, kDegree0) + row + "x", {"1 bytes follow"}));
  EXPECT_TRUE(refuses(header("ascii", 1000000, kDegree0) + "1 1 1\n", {"1000000 rows"}));
  EXPECT_TRUE(refuses(header("ascii", 2, kDegree0) + "1 1 1 1 1 1 1 1 1 1 1 1 1 1      \n                          \n",
                      {"row 2 of 2"}));
  EXPECT_TRUE(refuses(header("ascii", 1, kDegree0) + "1 1 1 1 one 1 1 1 1 1 1 1 1 1\n", {":19:", "f_dc_1", "\"one\""}));
}

TEST_F(SplatPly, OpaqueAndTransparentGaussiansOfOtherProgramsAreRead) {
  SplatCloud cloud = numbered_cloud(2, 0);
  cloud.logit_opacities = {INFINITY, -INFINITY};
  write_splat_ply(folder_ / "b.ply", cloud);
  EXPECT_EQ(read_splat_ply(folder_ / "b.ply").logit_opacities, (std::vector<float>{15, -15}));
  cloud.logit_opacities[1] = NAN;
  write_splat_ply(folder_ / "b.ply", cloud);
  EXPECT_TRUE(fails_with<InputError>({"b.ply", "row 1", "opacity", "nan"}, [&] { read_splat_ply(folder_ / "b.ply"); }));
}

TEST_F(SplatPly, FlatGaussiansOfOtherProgramsAreRead) {
  SplatCloud cloud = numbered_cloud(2, 0);
  cloud.log_scales = {1, 2, -INFINITY, INFINITY, 3, -INFINITY};
  write_splat_ply(folder_ / "b.ply", cloud);
  const SplatCloud back = read_splat_ply(folder_ / "b.ply");
  EXPECT_EQ(back.log_scales, (std::vector<float>{1, 2, -20, 20, 3, -20}));
  ASSERT_EQ(back.notes.size(), 1u);
  EXPECT_NE(back.notes[0].find("b.ply: 3 of 6 scales are infinite; -inf was read as -20, inf as 20"), std::string::npos)
      << back.notes[0];
  for (float* const value : {&cloud.means[4], &cloud.sh0[4], &cloud.quats[4]}) {  // others have no limit
    const float before = *value;
    *value = INFINITY;
    write_splat_ply(folder_ / "b.ply", cloud);
    EXPECT_TRUE(fails_with<InputError>({"b.ply", "row 1", "inf"}, [&] { read_splat_ply(folder_ / "b.ply"); }));
    *value = before;
  }
}

TEST_F(SplatPly, ColoursInPlaceOfShAreRead) {
  struct Case {
    const char* type;
    std::string bytes[3];
  };
  const Case cases[] = {
      {"uchar", {std::string(1, '\0'), std::string(1, '\x33'), std::string(1, '\xff')}},
      {"ushort", {bytes_of<std::uint16_t>(0), bytes_of<std::uint16_t>(13107), bytes_of<std::uint16_t>(65535)}},
      {"float", {bytes_of(0.f), bytes_of(0.2f), bytes_of(1.f)}}};
  for (const Case& own : cases) {
    std::string text = header("binary_little_endian", 1, kDegree0), data;
    for (const float value : {1.f, 2.f, 3.f}) data += bytes_of(value);
    for (int i = 0; i < 3; ++i) {
      const std::string from = "float f_dc_" + std::to_string(i);
      text.replace(text.find(from), from.size(), own.type + std::string(i == 0 ? " red" : i == 1 ? " green" : " blue"));
      data += own.bytes[i];
    }
    for (const float value : {0.5f, -3.f, -4.f, -5.f, 1.f, 0.f, 0.f, 0.f}) data += bytes_of(value);
    EXPECT_TRUE(is_splat_ply(store(text + data))) << own.type;
    const SplatCloud cloud = read_splat_ply(folder_ / "a.ply");
    EXPECT_EQ(cloud.sh_degree, 0);
    EXPECT_TRUE(cloud.notes.empty()) << own.type;
    EXPECT_EQ(cloud.log_scales, (std::vector<float>{-3, -4, -5}));
    for (std::size_t i = 0; i < 3; ++i) {
      EXPECT_NEAR(0.5 + 0.28209479177387814 * cloud.sh0.at(i), (std::vector<double>{0, 0.2, 1}[i]), 1e-6) << own.type;
    }
  }
}

TEST_F(SplatPly, GaussiansWithoutAPartAreNotTakenForPoints) {
  const auto without = [](const std::vector<std::string>& parts) {
    std::vector<std::string> names = kDegree0;
    for (const std::string& part : parts) names.erase(std::find(names.begin(), names.end(), part));
    return header("binary_little_endian", 0, names);
  };
  const std::vector<std::string> sh{"f_dc_0", "f_dc_1", "f_dc_2"};
  EXPECT_TRUE(refuses(without(sh), {"Gaussians without colours", "f_dc_0", "red", "found neither"}));
  EXPECT_TRUE(refuses(without({"opacity"}), {"no property opacity"}));
  EXPECT_TRUE(refuses(without({"f_dc_1"}), {"no property f_dc_1"}));
  EXPECT_TRUE(refuses(without({"scale_0", "scale_1", "scale_2"}), {"no property scale_0"}));
  EXPECT_TRUE(refuses(without({"f_dc_0", "f_dc_1", "f_dc_2", "opacity"}), {"Gaussians without colours"}));
  for (const auto& parts : {sh, {"opacity"}, {"rot_0"}, {"scale_0", "scale_1", "scale_2"}}) {
    EXPECT_TRUE(is_splat_ply(store(without(parts))));
  }
}

/// Returns two Gaussians as written by another program: the columns of kDegree0 and more.
std::string of_other_program(const std::vector<std::string>& more, const std::vector<float>& values,
                             const std::string& comment = "") {
  std::vector<std::string> names = kDegree0;
  names.insert(names.end(), more.begin(), more.end());
  std::string text = header("binary_little_endian", 2, names);
  if (!comment.empty()) text.insert(text.find("element"), "comment " + comment + "\n");
  for (std::size_t row = 0; row < 2; ++row) {
    for (const float value : {1.f, 2.f, 3.f, 0.1f, 0.2f, 0.3f, 0.5f, -3.f, -4.f, -20.f, 1.f, 0.f, 0.f, 0.f}) {
      text += bytes_of(value);
    }
    for (std::size_t k = 0; k < more.size(); ++k) text += bytes_of(values[row * more.size() + k]);
  }
  return text;
}

TEST_F(SplatPly, FilterOfMipSplattingIsAppliedToScalesAndOpacities) {
  const SplatCloud cloud = read_splat_ply(store(of_other_program({"filter_3D"}, {0.03f, 0})));
  ASSERT_EQ(cloud.size(), 2);
  double ratio = 1;
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const double scale = std::exp(std::vector<double>{-3, -4, -20}[axis]), filtered = std::hypot(scale, 0.03f);
    EXPECT_NEAR(cloud.log_scales[axis], std::log(filtered), 1e-6);
    ratio *= scale / filtered;
  }
  const double opacity = ratio / (1 + std::exp(-0.5));
  EXPECT_NEAR(cloud.logit_opacities[0], std::log(opacity / (1 - opacity)), 1e-5);
  EXPECT_EQ(std::vector<float>(cloud.log_scales.begin() + 3, cloud.log_scales.end()),
            (std::vector<float>{-3, -4, -20}));
  EXPECT_NEAR(cloud.logit_opacities[1], 0.5, 1e-6);
  EXPECT_FALSE(cloud.antialiased) << "as the files of create_fused_ply.py";
  ASSERT_EQ(cloud.notes.size(), 1u);
  EXPECT_NE(cloud.notes[0].find("a.ply: the 3D filter of Mip-Splatting (property filter_3D) was applied"),
            std::string::npos)
      << cloud.notes[0];
  EXPECT_TRUE(refuses(of_other_program({"filter_3D"}, {0.03f, NAN}), {"row 1", "filter_3D", "nan"}));
}

TEST_F(SplatPly, OpaqueGaussiansStayOpaqueWithAFilterThatIsSmall) {
  SplatCloud cloud = numbered_cloud(1, 0);
  cloud.logit_opacities = {50};
  include_filters({0}, cloud);
  EXPECT_GT(cloud.logit_opacities[0], 15);
  EXPECT_TRUE(std::isfinite(cloud.logit_opacities[0]));
}

TEST_F(SplatPly, PropertiesOfOtherProgramsAreNamed) {
  const auto notes = [&](const std::vector<std::string>& more, const std::string& comment = "") {
    const std::vector<float> values(2 * more.size(), 1);
    return read_splat_ply(store(of_other_program(more, values, comment))).notes;
  };
  EXPECT_TRUE(notes({"nx", "ny", "nz"}, "SplatRenderMode: mip").empty());
  EXPECT_TRUE(notes({"red", "green", "blue"}, "SplatRenderMode: default").empty());
  const std::vector<std::string> beta = notes({"beta", "t"});
  ASSERT_EQ(beta.size(), 1u);
  EXPECT_NE(beta[0].find("a.ply: ignored properties of another program: beta, t; "), std::string::npos) << beta[0];
  std::vector<std::string> many;
  for (int i = 0; i < 11; ++i) many.push_back("obj_dc_" + std::to_string(i));
  EXPECT_NE(notes(many).at(0).find("obj_dc_7 and 3 more; "), std::string::npos) << notes(many).at(0);
  const std::vector<std::string> mode = notes({}, "SplatRenderMode: other");
  ASSERT_EQ(mode.size(), 1u);
  EXPECT_NE(mode[0].find("SplatRenderMode: other"), std::string::npos) << mode[0];
}

TEST_F(SplatPly, NamesTheRowThatIsNotFiniteOrHasNoRotation) {
  SplatCloud cloud = numbered_cloud(3, 0);
  cloud.log_scales[3 * 1 + 2] = NAN;
  write_splat_ply(folder_ / "b.ply", cloud);
  EXPECT_TRUE(fails_with<InputError>({"b.ply", "row 1", "scale_2", "nan"}, [&] { read_splat_ply(folder_ / "b.ply"); }));
  cloud = numbered_cloud(3, 0);
  std::fill(cloud.quats.begin() + 8, cloud.quats.end(), 0.0f);
  write_splat_ply(folder_ / "b.ply", cloud);
  EXPECT_TRUE(fails_with<InputError>({"b.ply", "row 2", "length 0"}, [&] { read_splat_ply(folder_ / "b.ply"); }));
}

TEST_F(SplatPly, ListsOfAnyLengthAreCheckedAgainstTheFile) {
  const std::string text =
      "ply\nformat binary_little_endian 1.0\nelement vertex 1\nproperty list uint float a\nproperty float "
      "x\nend_header\n";
  EXPECT_TRUE(refuses(text + bytes_of<std::uint32_t>(4000000000u) + bytes_of(1.f), {"no property"}));
  const fs::path path = store(text + bytes_of<std::uint32_t>(4000000000u) + bytes_of(1.f));
  EXPECT_TRUE(fails_with<InputError>({"a.ply"}, [&] { read_point_ply(path); }));
}

TEST_F(SplatPly, RejectsAnUnwritablePlace) {
  write_bytes(folder_ / "plain", "x");
  EXPECT_TRUE(fails_with<IoError>({"plain/a.ply"},
                                  [&] { write_splat_ply(folder_ / "plain" / "a.ply", numbered_cloud(1, 0)); }));
}

TEST_F(SplatPly, IsDistinguishedFromPointsByItsHeader) {
  write_splat_ply(folder_ / "s.ply", numbered_cloud(1, 0));
  write_point_ply(folder_ / "p.ply", {{1, 2, 3}, {4, 5, 6}});
  EXPECT_TRUE(is_splat_ply(folder_ / "s.ply"));
  EXPECT_FALSE(is_splat_ply(folder_ / "p.ply"));
  EXPECT_TRUE(fails_with<InputError>({"p.ply", "no Gaussians, but points", "--init_ply"},
                                     [&] { read_splat_ply(folder_ / "p.ply"); }));
}

TEST(PointPly, ReadsBackPoints) {
  TempDir folder;
  const PointCloud points{{1, 2, 3, -4.5f, 5, 6e-9f}, {0, 128, 255, 1, 2, 3}};
  write_point_ply(folder / "p.ply", points);
  const WorldPoints back = read_point_ply(folder / "p.ply");
  EXPECT_EQ(in_frame({}, back).positions, points.positions);
  EXPECT_EQ(back.colors, points.colors);
  const std::string bytes = read_bytes(folder / "p.ply");
  EXPECT_EQ(bytes.substr(0, bytes.find("end_header")),
            "ply\nformat binary_little_endian 1.0\nelement vertex 2\nproperty float x\nproperty float y\n"
            "property float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n");
}

TEST(PointPly, ScalesColoursByTypeAndDefaultsToMidGrey) {
  TempDir folder;
  write_bytes(folder / "a.ply",
              "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n"
              "property float red\nproperty float green\nproperty float blue\nend_header\n1 2 3 0 0.5 1.5\n");
  EXPECT_EQ(read_point_ply(folder / "a.ply").colors, (std::vector<std::uint8_t>{0, 128, 255}));
  write_bytes(folder / "b.ply",
              "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n"
              "end_header\n1 2 3\n");
  EXPECT_EQ(read_point_ply(folder / "b.ply").colors, (std::vector<std::uint8_t>{128, 128, 128}));
  write_bytes(folder / "c.ply",
              "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nend_header\n1 2\n");
  EXPECT_TRUE(fails_with<InputError>({"c.ply", "no property z"}, [&] { read_point_ply(folder / "c.ply"); }));
}

TEST(PointPly, LeavesOutPointsThatAreNotFinite) {
  const TempDir folder;
  const std::string header =
      "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
      "property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n";
  write_bytes(folder / "a.ply", header + "1 2 3 10 20 30\n4 nan 6 40 50 60\n7 8 9 70 80 90\n");
  const WorldPoints points = read_point_ply(folder / "a.ply");
  EXPECT_EQ(points.positions, (std::vector<double>{1, 2, 3, 7, 8, 9}));
  EXPECT_EQ(points.colors, (std::vector<std::uint8_t>{10, 20, 30, 70, 80, 90}));
  EXPECT_EQ(points.left_out,
            (folder / "a.ply").string() +
                ": row 1 (counted from 0): expected a finite y, found nan; 1 of 3 points are left out");
  write_bytes(folder / "b.ply", header + "1 2 inf 1 1 1\n4 nan 6 1 1 1\nnan 8 9 1 1 1\n");
  EXPECT_TRUE(fails_with<InputError>({"b.ply: row 0", "finite z", "inf"}, [&] { read_point_ply(folder / "b.ply"); }));
}

TEST(PointPly, RejectsListsLongerThanTheFile) {
  const TempDir folder;
  const std::string begin = "element vertex 1\nproperty list ", end =
                                                                    "float more\nproperty float x\nproperty float y\n"
                                                                    "property float z\nend_header\n";
  for (const char* length : {"1e300", "nan", "-1", "99"}) {
    write_bytes(folder / "a.ply", "ply\nformat ascii 1.0\n" + begin + "uchar " + end + length + " 1 2 3 4\n");
    EXPECT_TRUE(fails_with<InputError>({"a.ply"}, [&] { read_point_ply(folder / "a.ply"); })) << length;
  }
  write_bytes(folder / "b.ply", "ply\nformat binary_little_endian 1.0\n" + begin + "uint " + end +
                                    bytes_of<std::uint32_t>(4000000000u) + std::string(20, '\0'));
  EXPECT_TRUE(fails_with<InputError>({"b.ply", "found length 4e+09"}, [&] { read_point_ply(folder / "b.ply"); }));
}

TEST(PointPly, ClampsColoursOfAnySize) {
  const TempDir folder;
  write_bytes(folder / "a.ply",
              "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nproperty "
              "float red\nproperty float green\nproperty float blue\nend_header\n1 2 3 1e38 -1e38 0.5\n");
  EXPECT_EQ(read_point_ply(folder / "a.ply").colors, (std::vector<std::uint8_t>{255, 0, 128}));
}

}  // namespace
}  // namespace b3dgs
