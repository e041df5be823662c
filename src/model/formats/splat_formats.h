// The stored (pre-activation) parameters of Gaussians in host memory, in their own frame. They are the contents of a
// PLY, and training starts from them.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "core/files/atomic_file.h"
#include "core/files/file_reader.h"
#include "scene/cameras/coordinate_frame.h"
#include "scene/points/point_cloud.h"

namespace b3dgs {

/// Returns the number of SH coefficients per channel for a degree: 1, 4, 9, 16.
constexpr int sh_coefficient_count(int degree) {
  return (degree + 1) * (degree + 1);
}

/// Returns the number of values of a Gaussian in SplatCloud::shN.
constexpr std::size_t sh_rest_count(int degree) {
  return 3 * static_cast<std::size_t>(sh_coefficient_count(degree) - 1);
}

/// The highest SH degree of PLY and SPZ files.
constexpr int kMaxShDegree = 3;

struct SplatCloud {
  int sh_degree = 0;  // 0 to kMaxShDegree
  // Trained with anti-aliasing. Scales and opacities include the 3D filter, and a renderer has to apply the 2D filter
  // (RenderSettings::antialiasing).
  bool antialiased = false;
  CoordinateFrame frame;               // of means and scales
  std::vector<float> means;            // [N, 3]
  std::vector<float> log_scales;       // [N, 3] natural log
  std::vector<float> quats;            // [N, 4] w, x, y, z, any length but 0
  std::vector<float> logit_opacities;  // [N]
  std::vector<float> sh0;              // [N, 3] RGB
  std::vector<float> shN;              // [N, K-1, 3], K = sh_coefficient_count(sh_degree), coefficient-major
  std::vector<std::string> notes;      // from the reader, for the user: deviations from the file

  std::int64_t size() const { return static_cast<std::int64_t>(logit_opacities.size()); }
};

/// Returns the world coordinates of the centres of every k-th Gaussian, fewer than twice `at_most`: [N, 3].
std::vector<double> world_positions(const SplatCloud& cloud, std::size_t at_most = static_cast<std::size_t>(-1));

/// Includes the 3D filter in scales and opacities, as viewers expect it in a file. `filters` has the standard deviation
/// of the filter of each Gaussian, in units of the cloud's frame.
void include_filters(const std::vector<float>& filters, SplatCloud& cloud);

/// Expresses the same Gaussians in another frame.
void change_frame(const CoordinateFrame& to, SplatCloud& cloud);

// PLY files of Gaussians, with the properties that 3DGS viewers read.

/// Writes binary_little_endian float32 properties in the order x y z nx ny nz f_dc_* f_rest_* opacity scale_* rot_* (62
/// for SH degree 3), in world coordinates. x y z are float64 if the Gaussians' frame is far from the world's origin
/// (CoordinateFrame::is_far). f_rest is channel-major, values are pre-activation, normals are 0. For anti-aliased
/// Gaussians the header has "comment SplatRenderMode: mip". The write is atomic. @throws IoError
void write_splat_ply(const std::filesystem::path& path, const SplatCloud& cloud);

/// Writes the same file in blocks, so that not all Gaussians have to be in host memory at once.
class SplatPlyWriter {
 public:
  /// @throws IoError
  SplatPlyWriter(const std::filesystem::path& path, std::int64_t count, int sh_degree, bool antialiased,
                 const CoordinateFrame& frame);

  /// Writes the next Gaussians. @throws IoError
  void append(const SplatCloud& rows);

  /// Completes the file and moves it into place. Call this after the last Gaussian. @throws IoError
  void commit();

 private:
  std::int64_t count_ = 0, n_written_ = 0;
  int sh_degree_ = 0;
  CoordinateFrame frame_;  // frame of the Gaussians
  AtomicFile file_;
};

/// Reads properties by name, in any order and of any scalar type, from binary (both byte orders) or ASCII files. The SH
/// degree follows from the number of f_rest properties. Normals are ignored. Gaussians that are exactly opaque or
/// transparent have infinite opacities, which become the largest finite ones, and infinite scales become -20 or 20. The
/// 3D filter of Mip-Splatting, filter_3D, is included in scales and opacities. Without f_dc_0 to f_dc_2, colours red,
/// green and blue are SH degree 0. Other properties are ignored with a note. Gaussians far from the world's origin get
/// a frame around them. Throws InputError, also for other values that are not finite and quaternions of length 0.
SplatCloud read_splat_ply(const std::filesystem::path& path);
SplatCloud read_splat_ply(FileReader& file);

/// Returns whether the header is one of Gaussians rather than plain points. @throws InputError if the file is not a PLY
bool is_splat_ply(const std::filesystem::path& path);

// SPZ, Niantic's compressed format of Gaussians (https://github.com/nianticlabs/spz). Versions 1 to 3 are a gzip stream
// of a header of 16 bytes and six arrays, little-endian:
//
//   uint32 magic ("NGSP"), version, count; uint8 SH degree (0-3), fractional bits, flags (1: anti-aliased, 2:
//   extensions after the arrays), 0 positions   3 x 24-bit fixed point with the header's fractional bits; version 1: 3
//   x 16-bit floating point opacities   uint8, 0 to 1 colours     3 x uint8, SH coefficient of degree 0: (byte / 255 -
//   0.5) / 0.15 log scales  3 x uint8: byte / 16 - 10 rotations   version 3: uint32, from the top 2 bits for the index
//   of the largest component in x, y, z, w, which is
//               positive, and 10 bits for each of the others in this order: sign, magnitude / 511 * sqrt(1/2).
//               Before: x, y, z as uint8: byte / 127.5 - 1, and w positive
//   SH          uint8 for each coefficient of degree 1 and higher, RGB: (byte - 128) / 128
//
// Version 4 has the same arrays, each as a Zstandard stream of its own. Its header is not compressed. The last byte of
// the 16 is the number of streams, 5 or 6 without SH, and these follow: uint32 offset of the table of streams, 12 zero
// bytes, extensions, for each stream uint64 compressed and uncompressed size, and the streams.
//
// Axes are right, up, back, but those of a PLY are right, down, front. Both functions convert: y and z change sign, and
// so do the SH coefficients that are odd in them.

/// Returns the number of fractional bits with which write_spz() stores positions: 12, a step of 1/4096 of a world unit.
/// There are more if Gaussians are so small that the step would be more than an eighth of their median scale, and fewer
/// if the largest coordinate does not fit into 24 bits. @throws InputError if it does not fit even without fraction
int spz_fractional_bits(const SplatCloud& cloud);

/// Default bits of an SH coefficient in write_spz(), the most that the format can store.
inline constexpr int kSpzShBits = 8;

/// Writes version 3 or 4. SH coefficients are stored from -1 to 1 with `sh_bits` bits (1 to 8), so in steps of 1/128
/// with 8 and of 1/8 with 4. Fewer bits compress better. Log scales are clamped to -10 to 5.94. The write is atomic.
/// @throws IoError; InputError as spz_fractional_bits()
void write_spz(const std::filesystem::path& path, const SplatCloud& cloud, int sh_bits = kSpzShBits, int version = 3);

/// Reads versions 1 to 4. Opacities of 0 and 1 become the finite values 0.001 and 0.999. Extensions are ignored, except
/// for one that says that the axes are others, which is an error. @throws InputError, also for a file that claims to
/// decompress to more than a hundred times its size
SplatCloud read_spz(const std::filesystem::path& path);
SplatCloud read_spz(FileReader& file);

// Files that the user names, in the format of their extension, in upper or lower case.

enum class SplatFormat { kPly, kSpz };

/// Returns nothing for other extensions.
std::optional<SplatFormat> splat_format(const std::filesystem::path& path);

/// Reads a file. Those with other extensions are read as PLY. @throws InputError
SplatCloud read_splats(const std::filesystem::path& path);

/// Returns whether to use read_splats() rather than read_point_ply(). @throws InputError
bool holds_splats(const std::filesystem::path& path);

/// @throws InputError for other extensions; IoError
void write_splats(const std::filesystem::path& path, const SplatCloud& cloud);

}  // namespace b3dgs
