#include <zlib.h>
#include <zstd.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <iterator>
#include <memory>
#include <new>
#include <numeric>
#include <string>
#include <string_view>

#include "core/check.h"
#include "model/formats/splat_formats.h"

namespace b3dgs {
namespace {

constexpr std::array<char, 4> kMagic{'N', 'G', 'S', 'P'};
constexpr std::uint32_t kLastVersion = 4;
constexpr std::uint8_t kAntialiased = 1;      // other flags announce extensions
constexpr int kGzipWindow = 15 + 16;          // requests a gzip header and checksum from zlib
constexpr std::size_t kMostAtOnce = 1 << 30;  // zlib's counters have 32 bits

constexpr int kPositionBits = 24, kDefaultFractionalBits = 12;
constexpr double kMaxFixed = (1 << (kPositionBits - 1)) - 1;
constexpr double kColorScale = 0.15;
constexpr double kQuatMagnitude = 511;
constexpr double kSqrtHalf = 0.70710678118654752;
constexpr float kShOne = 128;  // byte of the coefficient 0, and number of steps from there to 1

// Compressed real files are at least a third of the size of their content. A higher ratio than this is an attack or
// damage.
constexpr std::uint64_t kMaxRatio = 100, kAlwaysAllowed = 1 << 20;
constexpr std::size_t kMaxExtensionBytes = 1 << 20;  // of versions 1 to 3
constexpr int kZstdLevel = 12;

// Signs for conversion between right, down, front and right, up, back, in both directions, for coordinates and for SH
// coefficients from degree 1 in the order of SplatCloud::shN (y z x, xy yz zz xz xx-yy, ...).
constexpr std::array<float, 3> kAxisSigns{1, -1, -1};
constexpr std::array<float, 15> kShSigns{-1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1};

/// The header as stored in the file. Machines are little-endian (ply.cpp).
struct Header {
  std::array<char, 4> magic = kMagic;
  std::uint32_t version = 0, count = 0;
  std::uint8_t sh_degree = 0, fractional_bits = 0, flags = 0, n_streams = 0;  // n_streams: 0 before version 4

  bool is_zstd() const { return version >= 4; }
  std::size_t position_bytes() const { return version == 1 ? 6 : 9; }
  std::size_t rotation_bytes() const { return version < 3 ? 3 : 4; }
  /// Returns the sizes of the six arrays, in the order of the file.
  std::array<std::uint64_t, 6> array_bytes() const {
    const std::uint64_t n = count;
    return {n * position_bytes(), n, 3 * n, 3 * n, n * rotation_bytes(), n * sh_rest_count(sh_degree)};
  }
  std::size_t bytes() const {
    const std::array<std::uint64_t, 6> sizes = array_bytes();
    return std::accumulate(sizes.begin(), sizes.end(), std::uint64_t{0});
  }
};
constexpr std::size_t kHeaderBytes = 16;
static_assert(sizeof(Header) == kHeaderBytes);

/// The rest of the header since version 4.
struct ZstdHeader {
  std::uint32_t toc_offset = 0;
  std::array<std::uint32_t, 3> unused{};
};
constexpr std::size_t kZstdHeaderBytes = kHeaderBytes + 16;
static_assert(sizeof(ZstdHeader) == kZstdHeaderBytes - kHeaderBytes);

struct StreamSizes {
  std::uint64_t compressed = 0, content = 0;
};

/// A file after decompression.
struct Content {
  Header header;
  std::string arrays, extensions;
};

/// Returns the content of a gzip stream, but at most `most` bytes. @throws InputError if it is damaged, or ends before
/// the file does
std::string decompress(const std::string& compressed, std::size_t most, const std::string& name) {
  z_stream stream{};
  B3DGS_CHECK(inflateInit2(&stream, kGzipWindow) == Z_OK, "zlib cannot start");
  const std::unique_ptr<z_stream, int (*)(z_stream*)> at_end(&stream, inflateEnd);
  std::string content;  // grows with the data, regardless of the header
  std::size_t n_in = 0, n_out = 0;
  int result = Z_OK;
  while (result != Z_STREAM_END && n_out < most) {
    if (n_out == content.size()) content.resize(std::min(most, std::max(2 * n_out, std::size_t{1} << 20)));
    const auto in = static_cast<uInt>(std::min(kMostAtOnce, compressed.size() - n_in));
    const auto out = static_cast<uInt>(std::min(kMostAtOnce, content.size() - n_out));
    stream.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(compressed.data() + n_in));
    stream.avail_in = in;
    stream.next_out = reinterpret_cast<Bytef*>(content.data() + n_out);
    stream.avail_out = out;
    result = inflate(&stream, Z_NO_FLUSH);
    n_in += in - stream.avail_in;
    n_out += out - stream.avail_out;
    if (result == Z_MEM_ERROR) throw std::bad_alloc();
    if (result == Z_BUF_ERROR) {
      input_error(name, ": the compressed data end early; the file is truncated: copy or export it again");
    }
    if (result != Z_OK && result != Z_STREAM_END) {
      input_error(name, ": the compressed data are damaged (", stream.msg != nullptr ? stream.msg : "unknown reason",
                  "); copy or export the file again");
    }
  }
  if (result == Z_STREAM_END && n_in < compressed.size()) {
    input_error(name, ": expected the end of the file after the compressed data, found more bytes");
  }
  content.resize(n_out);
  return content;
}

void write_gzip(AtomicFile& file, const std::string& content) {
  constexpr int kMemoryLevel = 8;  // zlib's default
  z_stream stream{};
  B3DGS_CHECK(
      deflateInit2(&stream, Z_DEFAULT_COMPRESSION, Z_DEFLATED, kGzipWindow, kMemoryLevel, Z_DEFAULT_STRATEGY) == Z_OK,
      "zlib cannot start");
  const std::unique_ptr<z_stream, int (*)(z_stream*)> at_end(&stream, deflateEnd);
  std::array<Bytef, 1 << 16> block;
  std::size_t n_in = 0;
  for (int result = Z_OK; result != Z_STREAM_END;) {
    const auto in = static_cast<uInt>(std::min(kMostAtOnce, content.size() - n_in));
    stream.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(content.data() + n_in));
    stream.avail_in = in;
    stream.next_out = block.data();
    stream.avail_out = static_cast<uInt>(block.size());
    result = deflate(&stream, n_in + in == content.size() ? Z_FINISH : Z_NO_FLUSH);
    B3DGS_CHECK(result != Z_STREAM_ERROR, "zlib: inconsistent state");
    n_in += in - stream.avail_in;
    file.write(block.data(), block.size() - stream.avail_out);
  }
}

/// Rounds and clamps. NaN becomes 0.
std::uint8_t to_byte(double value) {
  return value >= 0 ? static_cast<std::uint8_t>(std::lround(std::min(value, 255.0))) : std::uint8_t{0};
}

/// @throws InputError also for a count too large for `compressed_bytes`, the size of the file
void check_header(const Header& header, std::uint64_t compressed_bytes, const std::string& name) {
  const int degree = header.sh_degree, bits = header.fractional_bits;
  if (header.magic != kMagic) {
    input_error(name, ": not an SPZ file (expected the content to begin with \"NGSP\"); it is of another format");
  }
  if (header.version < 1 || header.version > kLastVersion) {
    input_error(name, ": expected SPZ version 1 to ", kLastVersion, ", found ", header.version);
  }
  if (degree > kMaxShDegree) {
    input_error(name, ": expected SH degree 0 to 3, found ", degree, "; export it again with at most degree 3");
  }
  if (header.version > 1 && bits >= kPositionBits) {
    input_error(name, ": expected 0 to 23 fractional bits, found ", bits, "; the file is damaged");
  }
  if (header.bytes() > kAlwaysAllowed + kMaxRatio * compressed_bytes) {
    input_error(name, ": claims ", header.count, " Gaussians, ", header.bytes(), " bytes, in a file of ",
                compressed_bytes, " bytes; it is damaged");
  }
}

[[noreturn]] void fail_truncated(const std::string& name) {
  input_error(name, ": the file ends early; it is truncated: copy or export it again");
}

/// Reads versions 1 to 3.
Content read_gzip(const std::string& compressed, const std::string& name) {
  const auto expect_bytes = [&](const std::string& content, std::size_t wanted) {
    if (content.size() >= wanted) return;
    input_error(name, ": the compressed content ends ", wanted - content.size(),
                " or more bytes early; the file is damaged: export it again");
  };
  std::string all = decompress(compressed, kHeaderBytes, name);
  expect_bytes(all, kHeaderBytes);
  Content content;
  std::memcpy(&content.header, all.data(), kHeaderBytes);
  const Header& header = content.header;
  check_header(header, compressed.size(), name);
  if (header.is_zstd()) input_error(name, ": SPZ version ", header.version, " inside gzip; the file is damaged");
  const std::size_t expected = kHeaderBytes + header.bytes();
  const std::size_t most = expected + ((header.flags & ~kAntialiased) != 0 ? kMaxExtensionBytes : 0);
  all = decompress(compressed, most + 1, name);
  expect_bytes(all, expected);
  if (all.size() > most) {
    input_error(name, ": expected the end of the compressed content, found more; the file is damaged or of a later ",
                "version");
  }
  content.arrays = all.substr(kHeaderBytes, header.bytes());
  content.extensions = all.substr(expected);
  return content;
}

/// Reads version 4.
Content read_zstd(const std::string& file, const std::string& name) {
  if (file.size() < kZstdHeaderBytes) fail_truncated(name);
  Content content;
  ZstdHeader rest;
  std::memcpy(&content.header, file.data(), kHeaderBytes);
  std::memcpy(&rest, file.data() + kHeaderBytes, sizeof rest);
  const Header& header = content.header;
  check_header(header, file.size(), name);
  if (!header.is_zstd()) input_error(name, ": SPZ version ", header.version, " outside of gzip; the file is damaged");
  const std::array<std::uint64_t, 6> sizes = header.array_bytes();
  const std::size_t n_needed = sizes.back() > 0 ? sizes.size() : sizes.size() - 1;  // without SH, writers omit theirs
  if (header.n_streams < n_needed || header.n_streams > sizes.size() || rest.toc_offset < kZstdHeaderBytes) {
    input_error(name, ": expected ", n_needed, " streams and their table from byte 32 on, found ",
                int{header.n_streams}, " and a table at ", rest.toc_offset, "; the file is damaged");
  }
  std::size_t at = rest.toc_offset + header.n_streams * sizeof(StreamSizes);
  if (at > file.size()) fail_truncated(name);
  content.extensions = file.substr(kZstdHeaderBytes, rest.toc_offset - kZstdHeaderBytes);
  content.arrays.resize(header.bytes());
  char* to = content.arrays.data();
  for (std::size_t i = 0; i < header.n_streams; ++i) {
    StreamSizes stream;
    std::memcpy(&stream, file.data() + rest.toc_offset + i * sizeof stream, sizeof stream);
    if (stream.content != sizes[i]) {
      input_error(name, ": stream ", i, " (counted from 0): expected ", sizes[i], " bytes for ", header.count,
                  " Gaussians, found ", stream.content, "; the file is damaged");
    }
    if (stream.compressed > file.size() - at) fail_truncated(name);
    const std::size_t result = ZSTD_decompress(to, sizes[i], file.data() + at, stream.compressed);
    if (ZSTD_isError(result) != 0 || result != sizes[i]) {
      input_error(name, ": the compressed data are damaged (",
                  ZSTD_isError(result) != 0 ? ZSTD_getErrorName(result) : "they end early",
                  "); copy or export the file again");
    }
    to += sizes[i];
    at += stream.compressed;
  }
  if (at < file.size()) {
    input_error(name, ": expected the end of the file after the compressed data, found more bytes");
  }
  return content;
}

/// Extensions are records of a type, a size and as many bytes. Most describe nothing that is needed here, but one says
/// that the axes are not those of the format. @throws InputError in this case
void check_extensions(std::string_view records, const std::string& name) {
  constexpr std::uint32_t kCoordinateSystem = 0xADBE0003;
  constexpr std::uint32_t kUnspecified = 0, kRightUpBack = 4;
  std::array<std::uint32_t, 3> record{};  // type, size, and the first word
  while (records.size() >= sizeof record) {
    std::memcpy(record.data(), records.data(), sizeof record);
    if (record[0] == kCoordinateSystem && record[2] != kUnspecified && record[2] != kRightUpBack) {
      input_error(name, ": an extension says that its axes are not right, up, back (coordinate system ", record[2],
                  "); convert it first: splat-transform IN.spz OUT.ply");
    }
    records.remove_prefix(std::min<std::size_t>(records.size(), 8 + std::size_t{record[1]}));
  }
}

void write_zstd(AtomicFile& file, const Header& header, const char* arrays) {
  ZstdHeader rest;
  rest.toc_offset = kZstdHeaderBytes;
  const std::array<std::uint64_t, 6> sizes = header.array_bytes();
  std::vector<StreamSizes> table;
  std::string streams;
  for (std::size_t i = 0; i < header.n_streams; ++i) {
    const std::size_t before = streams.size(), bound = ZSTD_compressBound(sizes[i]);
    streams.resize(before + bound);
    const std::size_t written = ZSTD_compress(&streams[before], bound, arrays, sizes[i], kZstdLevel);
    if (ZSTD_isError(written) != 0) throw std::bad_alloc();  // it has no other reason to fail
    streams.resize(before + written);
    table.push_back({written, sizes[i]});
    arrays += sizes[i];
  }
  file.write(&header, sizeof header);
  file.write(&rest, sizeof rest);
  file.write(table.data(), table.size() * sizeof(StreamSizes));
  file.write(streams.data(), streams.size());
}

float half_to_float(std::uint32_t half) {
  const int exponent = static_cast<int>(half >> 10 & 31);
  const auto fraction = static_cast<float>(half & 1023);
  const float magnitude = exponent == 0 ? std::ldexp(fraction, -24) : std::ldexp(fraction + 1024, exponent - 25);
  return (half & 0x8000) != 0 ? -magnitude : magnitude;
}

void decode_halves(std::uint64_t row, const std::uint8_t* bytes, float* xyz, const std::string& name) {
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const std::uint32_t half = bytes[2 * axis] | static_cast<std::uint32_t>(bytes[2 * axis + 1]) << 8;
    if ((half >> 10 & 31) == 31) {  // infinite or NaN
      input_error(name, ": Gaussian ", row, " (counted from 0): expected a finite position; export it again");
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

/// Converts x, y, z, w in the file's axes to w, x, y, z in those of a PLY.
void decode_rotation(const Header& header, const std::uint8_t* bytes, float* wxyz) {
  std::array<double, 4> xyzw{};
  std::size_t missing = 3;  // not in the file, because the length is 1
  if (header.version < 3) {
    for (std::size_t i = 0; i < 3; ++i) xyzw[i] = bytes[i] / 127.5 - 1;
  } else {
    std::uint32_t packed = 0;
    std::memcpy(&packed, bytes, sizeof packed);
    missing = packed >> 30;
    for (std::size_t i = 4; i-- > 0;) {
      if (i == missing) continue;
      const double magnitude = (packed & 511) / kQuatMagnitude * kSqrtHalf;
      xyzw[i] = (packed & 512) != 0 ? -magnitude : magnitude;
      packed >>= 10;
    }
  }
  double sum = 0;
  for (const double value : xyzw) sum += value * value;
  xyzw[missing] = std::sqrt(std::max(0.0, 1 - sum));
  wxyz[0] = static_cast<float>(xyzw[3]);
  for (std::size_t axis = 0; axis < 3; ++axis) wxyz[axis + 1] = kAxisSigns[axis] * static_cast<float>(xyzw[axis]);
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
  std::memcpy(bytes, &packed, sizeof packed);
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

void write_spz(const std::filesystem::path& path, const SplatCloud& cloud, int sh_bits, int version) {
  B3DGS_CHECK(cloud.sh_degree >= 0 && cloud.sh_degree <= kMaxShDegree, "SH degree ", cloud.sh_degree);
  B3DGS_CHECK(cloud.size() <= 0xffffffff, cloud.size(), " Gaussians");
  B3DGS_CHECK(sh_bits >= 1 && sh_bits <= kSpzShBits, sh_bits, " bits");
  B3DGS_CHECK(version == 3 || version == 4, "version ", version);
  Header header;
  header.version = static_cast<std::uint32_t>(version);
  header.count = static_cast<std::uint32_t>(cloud.size());
  header.sh_degree = static_cast<std::uint8_t>(cloud.sh_degree);
  header.fractional_bits = static_cast<std::uint8_t>(spz_fractional_bits(cloud));
  header.flags = cloud.antialiased ? kAntialiased : 0;
  if (header.is_zstd()) header.n_streams = cloud.sh_degree > 0 ? 6 : 5;
  const double log_unit = std::log(cloud.frame.unit), sh_step = 1 << (kSpzShBits - sh_bits);
  const std::size_t n = header.count, n_sh = sh_rest_count(header.sh_degree);
  std::string content(kHeaderBytes + header.bytes(), '\0');
  auto* to = reinterpret_cast<std::uint8_t*>(content.data());
  std::memcpy(to, &header, kHeaderBytes);
  to += kHeaderBytes;
  for (std::size_t row = 0; row < n; ++row, to += 9) {
    encode_fixed(cloud.frame.to_world(&cloud.means[3 * row]), header.fractional_bits, to);
  }
  for (const float logit : cloud.logit_opacities) *to++ = to_byte(255 / (1 + std::exp(-static_cast<double>(logit))));
  for (const float color : cloud.sh0) *to++ = to_byte((color * kColorScale + 0.5) * 255);
  for (const float scale : cloud.log_scales) *to++ = to_byte((scale + log_unit + 10.0) * 16);
  for (std::size_t row = 0; row < n; ++row, to += 4) encode_smallest_three(&cloud.quats[4 * row], to);
  for (std::size_t i = 0; i < n * n_sh; ++i) {
    const double value = kShSigns[i % n_sh / 3] * cloud.shN[i];
    *to++ = to_byte(std::round((value * kShOne + kShOne) / sh_step) * sh_step);
  }
  AtomicFile file(path);
  header.is_zstd() ? write_zstd(file, header, content.data() + kHeaderBytes) : write_gzip(file, content);
  file.commit();
}

SplatCloud read_spz(const std::filesystem::path& path) {
  FileReader file(path);
  return read_spz(file);
}

SplatCloud read_spz(FileReader& file) {
  const std::string name = file.name();
  std::string bytes(file.remaining(), '\0');
  file.read_bytes(bytes.data(), bytes.size());
  const bool is_zstd = bytes.compare(0, kMagic.size(), kMagic.data(), kMagic.size()) == 0;
  const Content content = is_zstd ? read_zstd(bytes, name) : read_gzip(bytes, name);
  const Header& header = content.header;
  if ((header.flags & ~kAntialiased) != 0) check_extensions(content.extensions, name);
  const std::size_t n = header.count, n_sh = sh_rest_count(header.sh_degree);

  SplatCloud cloud;
  cloud.sh_degree = header.sh_degree;
  cloud.antialiased = (header.flags & kAntialiased) != 0;
  const auto* from = reinterpret_cast<const std::uint8_t*>(content.arrays.data());
  cloud.means.resize(3 * n);
  for (std::size_t row = 0; row < n; ++row, from += header.position_bytes()) {
    float* const xyz = &cloud.means[3 * row];
    header.version == 1 ? decode_halves(row, from, xyz, name) : decode_fixed(from, header.fractional_bits, xyz);
  }
  cloud.logit_opacities.resize(n);
  for (float& logit : cloud.logit_opacities) logit = decode_opacity(*from++);
  cloud.sh0.resize(3 * n);
  for (float& color : cloud.sh0) color = static_cast<float>((*from++ / 255.0 - 0.5) / kColorScale);
  cloud.log_scales.resize(3 * n);
  for (float& scale : cloud.log_scales) scale = static_cast<float>(*from++) / 16 - 10;
  cloud.quats.resize(4 * n);
  for (std::size_t row = 0; row < n; ++row, from += header.rotation_bytes()) {
    decode_rotation(header, from, &cloud.quats[4 * row]);
  }
  cloud.shN.resize(n * n_sh);
  for (std::size_t i = 0; i < n * n_sh; ++i) {
    cloud.shN[i] = kShSigns[i % n_sh / 3] * (static_cast<float>(*from++) - kShOne) / kShOne;
  }
  return cloud;
}

}  // namespace b3dgs
