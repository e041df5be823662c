// PLY files of Gaussians, with the properties that 3DGS viewers read.
#pragma once

#include <cstdint>
#include <filesystem>

#include "core/files/atomic_file.h"
#include "core/files/file_reader.h"
#include "model/formats/splat_cloud.h"
#include "scene/points/point_cloud.h"

namespace b3dgs {

/// Writes binary_little_endian float32 properties in the order x y z nx ny nz f_dc_* f_rest_* opacity scale_* rot_*
/// (62 for SH degree 3), in world coordinates; x y z are float64 if the Gaussians' frame is far from the world's origin
/// (CoordinateFrame::is_far). f_rest is channel-major, values are pre-activation, normals are 0. Of anti-aliased
/// Gaussians the header says "comment SplatRenderMode: mip". The file appears complete or not at all. @throws IoError
void write_splat_ply(const std::filesystem::path& path, const SplatCloud& cloud);

/// Writes the same file in blocks of rows, so that not all Gaussians have to be in host memory at once.
class SplatPlyWriter {
 public:
  /// @throws IoError
  SplatPlyWriter(const std::filesystem::path& path, std::int64_t count, int sh_degree, bool antialiased,
                 const CoordinateFrame& frame);

  /// Writes the next rows. @throws IoError
  void append(const SplatCloud& rows);

  /// Makes the file appear; call after the last row. @throws IoError
  void commit();

 private:
  std::int64_t count_ = 0, n_written_ = 0;
  int sh_degree_ = 0;
  CoordinateFrame frame_;  // of the rows
  AtomicFile file_;
};

/// Reads properties by name, in any order and of any scalar type, from binary (both byte orders) or ASCII files. The SH
/// degree follows from the number of f_rest properties; normals are ignored. Infinite opacities, of Gaussians that
/// are exactly opaque or transparent, become the largest finite ones. Gaussians far from the world's origin get a frame
/// around them. @throws InputError, also for other values that
/// are not finite and quaternions of length 0
SplatCloud read_splat_ply(const std::filesystem::path& path);
SplatCloud read_splat_ply(FileReader& file);

/// Whether the header is one of Gaussians rather than plain points. @throws InputError if the file is not a PLY
bool is_splat_ply(const std::filesystem::path& path);

}  // namespace b3dgs
