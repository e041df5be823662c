#include "model/formats/splat_formats.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <iterator>
#include <string>

#include "core/check.h"
#include "model/formats/gzip.h"

namespace b3dgs {
namespace {

constexpr char kMagic[4] = {'N', 'G', 'S', 'P'};
constexpr std::size_t kHeaderBytes = 16;
constexpr std::uint32_t kWrittenVersion = 3, kLastGzipVersion = 3;
constexpr std::uint8_t kAntialiased = 1;  // the other flags announce data after the arrays
constexpr std::size_t kSplatsPerBlock = 4096;

constexpr int kPositionBits = 24, kDefaultFractionalBits = 12;
constexpr double kMaxFixed = (1 << (kPositionBits - 1)) - 1;
constexpr double kColorScale = 0.15;
constexpr double kQuatMagnitude = 511;
constexpr double kSqrtHalf = 0.70710678118654752;
constexpr double kShOne = 128;  // byte of the coefficient 0, and steps from there to 1

// Real files hold at least a byte for each three of their content. More than this is an attack or damage.
constexpr std::uint64_t kMaxRatio = 100, kAlwaysAllowed = 1 << 20;

// Signs from right, down, front to right, up, back and the other way: of coordinates, and of SH coefficients from
// degree 1 in the order of SplatCloud::shN (y z x, xy yz zz xz xx-yy, ...).
constexpr std::array<float, 3> kAxisSigns{1, -1, -1};
constexpr std::array<float, 15> kShSigns{-1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1};

struct Header {
  std::uint32_t version = kWrittenVersion;
  std::uint64_t count = 0;
  int sh_degree = 0, fractional_bits = kDefaultFractionalBits;
  std::uint8_t flags = 0;

  std::size_t rest() const { return static_cast<std::size_t>(sh_coefficient_count(sh_degree)) - 1; }
  std::size_t position_bytes() const { return version == 1 ? 6 : 9; }
  std::size_t rotation_bytes() const { return version < 3 ? 3 : 4; }
  std::size_t bytes_each() const { return position_bytes() + 1 + 3 + 3 + rotation_bytes() + 3 * rest(); }
};

std::uint32_t load_u32(const std::uint8_t* bytes) {
  return bytes[0] | bytes[1] << 8 | bytes[2] << 16 | static_cast<std::uint32_t>(bytes[3]) << 24;
}

void store_u32(std::uint32_t value, std::uint8_t* bytes) {
  for (int i = 0; i < 4; ++i) bytes[i] = static_cast<std::uint8_t>(value >> (8 * i));
}

/// Rounded and clamped; NaN becomes 0.
std::uint8_t to_byte(double value) {
  return value >= 0 ? static_cast<std::uint8_t>(std::lround(std::min(value, 255.0))) : std::uint8_t{0};
}

Header parse_header(const std::uint8_t* bytes, const FileReader& file) {
  if (std::memcmp(bytes, kMagic, sizeof kMagic) != 0) {
    input_error(file.name(),
                ": not an SPZ file (expected the content to begin with \"NGSP\"); it is of another format");
  }
  Header header;
  header.version = load_u32(bytes + 4);
  header.count = load_u32(bytes + 8);
  header.sh_degree = bytes[12];
  header.fractional_bits = bytes[13];
  header.flags = bytes[14];
  if (header.version < 1 || header.version > kLastGzipVersion) {
    input_error(file.name(), ": expected SPZ version 1 to 3, found ", header.version);
  }
  if (header.sh_degree > kMaxShDegree) {
    input_error(file.name(), ": expected SH degree 0 to 3, found ", header.sh_degree,
                "; export it again with at most degree 3");
  }
  if (header.version > 1 && header.fractional_bits >= kPositionBits) {
    input_error(file.name(), ": expected 0 to 23 fractional bits, found ", header.fractional_bits,
                "; the file is damaged");
  }
  return header;
}

/// @param compressed_bytes of the whole file
void check_count(const Header& header, std::uint64_t compressed_bytes, const FileReader& file) {
  const std::uint64_t bytes = header.count * header.bytes_each();
  if (bytes > kAlwaysAllowed + kMaxRatio * compressed_bytes) {
    input_error(file.name(), ": claims ", header.count, " Gaussians, ", bytes, " bytes, in a file of ",
                compressed_bytes, " bytes; it is damaged");
  }
}

/// Reads the next array of `width` bytes a Gaussian and calls decode(index, bytes) for each.
template <class Decode>
void read_array(GzipReader& gzip, std::uint64_t count, std::size_t width, Decode&& decode) {
  std::vector<std::uint8_t> block(kSplatsPerBlock * width);
  for (std::uint64_t begin = 0; begin < count; begin += kSplatsPerBlock) {
    const std::uint64_t n = std::min<std::uint64_t>(kSplatsPerBlock, count - begin);
    gzip.read_bytes(block.data(), n * width);
    for (std::uint64_t i = 0; i < n; ++i) decode(begin + i, block.data() + i * width);
  }
}

float half_to_float(std::uint32_t half) {
  const int exponent = static_cast<int>(half >> 10 & 31);
  const auto fraction = static_cast<float>(half & 1023);
  const float magnitude = exponent == 0 ? std::ldexp(fraction, -24) : std::ldexp(fraction + 1024, exponent - 25);
  return (half & 0x8000) != 0 ? -magnitude : magnitude;
}

void decode_halves(std::uint64_t row, const std::uint8_t* bytes, float* xyz, const FileReader& file) {
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const std::uint32_t half = bytes[2 * axis] | static_cast<std::uint32_t>(bytes[2 * axis + 1]) << 8;
    if ((half >> 10 & 31) == 31) {  // infinite or NaN
      input_error(file.name(), ": Gaussian ", row, " (counted from 0): expected a finite position; export it again");
    }
    xyz[axis] = kAxisSigns[axis] * half_to_float(half);
  }
}

void decode_fixed(const std::uint8_t* bytes, int fractional_bits, float* xyz) {
  for (std::size_t axis = 0; axis < 3; ++axis, bytes += 3) {
    const std::int32_t fixed = (bytes[2] << 16 | bytes[1] << 8 | bytes[0]) - (bytes[2] < 128 ? 0 : 1 << 24);
    xyz[axis] = kAxisSigns[axis] * std::ldexp(static_cast<float>(fixed), -fractional_bits);
  }
}

/// x, y, z, w in the file's axes to w, x, y, z in those of a PLY.
void store_quat(const std::array<double, 4>& xyzw, float* wxyz) {
  wxyz[0] = static_cast<float>(xyzw[3]);
  for (std::size_t axis = 0; axis < 3; ++axis) wxyz[axis + 1] = kAxisSigns[axis] * static_cast<float>(xyzw[axis]);
}

double last_component(double sum_of_squares) {
  return std::sqrt(std::max(0.0, 1 - sum_of_squares));
}

void decode_smallest_three(const std::uint8_t* bytes, float* quat) {
  std::uint32_t packed = load_u32(bytes);
  const std::size_t largest = packed >> 30;
  std::array<double, 4> xyzw{};
  double sum = 0;
  for (std::size_t i = 4; i-- > 0;) {
    if (i == largest) continue;
    const double magnitude = (packed & 511) / kQuatMagnitude * kSqrtHalf;
    xyzw[i] = (packed & 512) != 0 ? -magnitude : magnitude;
    sum += magnitude * magnitude;
    packed >>= 10;
  }
  xyzw[largest] = last_component(sum);
  store_quat(xyzw, quat);
}

void decode_first_three(const std::uint8_t* bytes, float* quat) {
  std::array<double, 4> xyzw{};
  double sum = 0;
  for (std::size_t i = 0; i < 3; ++i) {
    xyzw[i] = bytes[i] / 127.5 - 1;
    sum += xyzw[i] * xyzw[i];
  }
  xyzw[3] = last_component(sum);
  store_quat(xyzw, quat);
}

float decode_opacity(std::uint8_t byte) {
  constexpr double kQuarter = 0.25;  // of a step from 0 and 1, whose logits are infinite
  const double opacity = std::clamp<double>(byte, kQuarter, 255 - kQuarter) / 255;
  return static_cast<float>(std::log(opacity / (1 - opacity)));
}

void encode_fixed(const std::array<double, 3>& xyz, int fractional_bits, std::uint8_t* bytes) {
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const double scaled = std::ldexp(static_cast<double>(kAxisSigns[axis]) * xyz[axis], fractional_bits);
    const auto fixed = static_cast<std::uint32_t>(std::lround(scaled));
    for (int k = 0; k < 3; ++k) *bytes++ = static_cast<std::uint8_t>(fixed >> (8 * k));
  }
}

void encode_smallest_three(const float* quat, std::uint8_t* bytes) {
  std::array<double, 4> xyzw{kAxisSigns[0] * quat[1], kAxisSigns[1] * quat[2], kAxisSigns[2] * quat[3], quat[0]};
  const double length = std::hypot(std::hypot(xyzw[0], xyzw[1]), std::hypot(xyzw[2], xyzw[3]));
  std::size_t largest = 0;
  for (std::size_t i = 1; i < 4; ++i) {
    if (std::abs(xyzw[i]) > std::abs(xyzw[largest])) largest = i;
  }
  const double sign = xyzw[largest] < 0 ? -1 : 1;
  auto packed = static_cast<std::uint32_t>(largest);
  for (std::size_t i = 0; i < 4; ++i) {
    if (i == largest) continue;
    const double value = sign * xyzw[i] / length;
    const double magnitude = std::min(std::round(std::abs(value) / kSqrtHalf * kQuatMagnitude), kQuatMagnitude);
    packed = packed << 10 | (value < 0 ? 512u : 0u) | static_cast<std::uint32_t>(magnitude);
  }
  store_u32(packed, bytes);
}

std::uint8_t encode_sh(float value, double step) {
  return to_byte(std::round((value * kShOne + kShOne) / step) * step);
}

/// Calls encode(index, bytes) for each Gaussian and writes the array of `width` bytes a Gaussian.
template <class Encode>
void write_array(GzipWriter& gzip, std::uint64_t count, std::size_t width, Encode&& encode) {
  std::vector<std::uint8_t> block(kSplatsPerBlock * width);
  for (std::uint64_t begin = 0; begin < count; begin += kSplatsPerBlock) {
    const std::uint64_t n = std::min<std::uint64_t>(kSplatsPerBlock, count - begin);
    for (std::uint64_t i = 0; i < n; ++i) encode(begin + i, block.data() + i * width);
    gzip.write(block.data(), n * width);
  }
}

void write_header(GzipWriter& gzip, const Header& header) {
  std::array<std::uint8_t, kHeaderBytes> bytes{};
  std::memcpy(bytes.data(), kMagic, sizeof kMagic);
  store_u32(header.version, bytes.data() + 4);
  store_u32(static_cast<std::uint32_t>(header.count), bytes.data() + 8);
  bytes[12] = static_cast<std::uint8_t>(header.sh_degree);
  bytes[13] = static_cast<std::uint8_t>(header.fractional_bits);
  bytes[14] = header.flags;
  gzip.write(bytes.data(), bytes.size());
}

}  // namespace

int spz_fractional_bits(const SplatCloud& cloud) {
  double extent = 0;
  for (std::size_t i = 0; i < cloud.means.size(); i += 3) {
    for (const double value : cloud.frame.to_world(&cloud.means[i])) {
      B3DGS_CHECK(std::isfinite(value), "expected finite positions, found ", value);
      extent = std::max(extent, std::abs(value));
    }
  }
  if (std::round(extent) > kMaxFixed) {
    input_error("a Gaussian has the coordinate ", extent, ", and SPZ holds coordinates up to ", kMaxFixed,
                "; leave out those far away (export --crop)");
  }
  int wanted = kDefaultFractionalBits;
  std::vector<float> scales;
  std::copy_if(cloud.log_scales.begin(), cloud.log_scales.end(), std::back_inserter(scales),
               [](float value) { return std::isfinite(value); });
  if (!scales.empty()) {
    constexpr double kStepsPerScale = 8;
    const auto middle = scales.begin() + static_cast<std::ptrdiff_t>(scales.size() / 2);
    std::nth_element(scales.begin(), middle, scales.end());
    const double world = *middle + std::log(cloud.frame.unit);
    const double bits = std::ceil(std::log2(kStepsPerScale) - world / std::log(2.0));
    wanted = static_cast<int>(std::clamp<double>(bits, kDefaultFractionalBits, kPositionBits - 1));
  }
  while (std::round(std::ldexp(extent, wanted)) > kMaxFixed) --wanted;
  return wanted;
}

void write_spz(const std::filesystem::path& path, const SplatCloud& cloud, int sh_bits) {
  Header header;
  header.count = static_cast<std::uint64_t>(cloud.size());
  header.sh_degree = cloud.sh_degree;
  header.fractional_bits = spz_fractional_bits(cloud);
  header.flags = cloud.antialiased ? kAntialiased : 0;
  B3DGS_CHECK(cloud.sh_degree >= 0 && cloud.sh_degree <= kMaxShDegree, "SH degree ", cloud.sh_degree);
  B3DGS_CHECK(header.count <= 0xffffffffu, header.count, " Gaussians");
  B3DGS_CHECK(sh_bits >= 1 && sh_bits <= kSpzShBits, sh_bits, " bits");
  const double log_unit = std::log(cloud.frame.unit);
  AtomicFile file(path);
  GzipWriter gzip(file);
  write_header(gzip, header);
  write_array(gzip, header.count, 9, [&](std::uint64_t row, std::uint8_t* bytes) {
    encode_fixed(cloud.frame.to_world(&cloud.means[3 * row]), header.fractional_bits, bytes);
  });
  write_array(gzip, header.count, 1, [&](std::uint64_t row, std::uint8_t* bytes) {
    *bytes = to_byte(255 / (1 + std::exp(-static_cast<double>(cloud.logit_opacities[row]))));
  });
  write_array(gzip, header.count, 3, [&](std::uint64_t row, std::uint8_t* bytes) {
    for (std::size_t k = 0; k < 3; ++k) bytes[k] = to_byte((cloud.sh0[3 * row + k] * kColorScale + 0.5) * 255);
  });
  write_array(gzip, header.count, 3, [&](std::uint64_t row, std::uint8_t* bytes) {
    for (std::size_t k = 0; k < 3; ++k) bytes[k] = to_byte((cloud.log_scales[3 * row + k] + log_unit + 10.0) * 16);
  });
  write_array(gzip, header.count, header.rotation_bytes(),
              [&](std::uint64_t row, std::uint8_t* bytes) { encode_smallest_three(&cloud.quats[4 * row], bytes); });
  const std::size_t rest = header.rest();
  const double sh_step = 1 << (kSpzShBits - sh_bits);
  write_array(gzip, header.count, 3 * rest, [&](std::uint64_t row, std::uint8_t* bytes) {
    const float* const sh = cloud.shN.data() + 3 * rest * row;
    for (std::size_t k = 0; k < 3 * rest; ++k) bytes[k] = encode_sh(kShSigns[k / 3] * sh[k], sh_step);
  });
  gzip.write(nullptr, 0, /*is_last=*/true);
  file.commit();
}

SplatCloud read_spz(const std::filesystem::path& path) {
  FileReader file(path);
  return read_spz(file);
}

SplatCloud read_spz(FileReader& file) {
  GzipReader gzip(file);
  if (gzip.compressed().compare(0, sizeof kMagic, kMagic, sizeof kMagic) == 0) {
    input_error(file.name(),
                ": expected SPZ version 1 to 3, found version 4 or later, which is compressed in another "
                "way; convert it first: splat-transform IN.spz OUT.ply");
  }
  std::array<std::uint8_t, kHeaderBytes> bytes{};
  gzip.read_bytes(bytes.data(), bytes.size());
  const Header header = parse_header(bytes.data(), file);
  check_count(header, gzip.compressed().size(), file);

  const std::uint64_t n = header.count;
  const std::size_t rest = header.rest();
  SplatCloud cloud;
  cloud.sh_degree = header.sh_degree;
  cloud.antialiased = (header.flags & kAntialiased) != 0;
  cloud.means.resize(3 * n);
  read_array(gzip, n, header.position_bytes(), [&](std::uint64_t row, const std::uint8_t* from) {
    float* const to = &cloud.means[3 * row];
    header.version == 1 ? decode_halves(row, from, to, file) : decode_fixed(from, header.fractional_bits, to);
  });
  cloud.logit_opacities.resize(n);
  read_array(gzip, n, 1,
             [&](std::uint64_t row, const std::uint8_t* from) { cloud.logit_opacities[row] = decode_opacity(*from); });
  cloud.sh0.resize(3 * n);
  read_array(gzip, n, 3, [&](std::uint64_t row, const std::uint8_t* from) {
    for (std::size_t k = 0; k < 3; ++k) {
      cloud.sh0[3 * row + k] = static_cast<float>((from[k] / 255.0 - 0.5) / kColorScale);
    }
  });
  cloud.log_scales.resize(3 * n);
  read_array(gzip, n, 3, [&](std::uint64_t row, const std::uint8_t* from) {
    for (std::size_t k = 0; k < 3; ++k) cloud.log_scales[3 * row + k] = static_cast<float>(from[k]) / 16 - 10;
  });
  cloud.quats.resize(4 * n);
  read_array(gzip, n, header.rotation_bytes(), [&](std::uint64_t row, const std::uint8_t* from) {
    float* const to = &cloud.quats[4 * row];
    header.version < 3 ? decode_first_three(from, to) : decode_smallest_three(from, to);
  });
  cloud.shN.resize(3 * rest * n);
  read_array(gzip, n, 3 * rest, [&](std::uint64_t row, const std::uint8_t* from) {
    float* const to = cloud.shN.data() + 3 * rest * row;
    for (std::size_t k = 0; k < 3 * rest; ++k) {
      to[k] = kShSigns[k / 3] * (static_cast<float>(from[k]) - static_cast<float>(kShOne)) / static_cast<float>(kShOne);
    }
  });
  constexpr std::size_t kMaxExtensionBytes = 1 << 20;
  gzip.expect_end((header.flags & ~kAntialiased) != 0 ? kMaxExtensionBytes : 0);
  return cloud;
}

}  // namespace b3dgs
