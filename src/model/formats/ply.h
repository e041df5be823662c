// PLY files: Gaussians in the layout of the 3DGS viewers, and plain point clouds.
#pragma once

#include <cstdint>
#include <filesystem>

#include "core/files/atomic_file.h"
#include "core/files/file_reader.h"
#include "model/formats/splat_cloud.h"
#include "scene/point_cloud.h"

namespace b3dgs {

/// Writes binary_little_endian float32 properties in the order x y z nx ny nz f_dc_* f_rest_* opacity scale_* rot_*
/// (62 for SH degree 3). f_rest is channel-major, values are pre-activation, normals are 0. The file appears whole or
/// not at all. @throws IoError
void write_splat_ply(const std::filesystem::path& path, const SplatCloud& cloud);

/// The same file, written in blocks of rows, for Gaussians that are in host memory in blocks only.
class SplatPlyWriter {
 public:
  /// @throws IoError
  SplatPlyWriter(const std::filesystem::path& path, std::int64_t count, int sh_degree);

  /// The next rows. @throws IoError
  void append(const SplatCloud& rows);

  /// After the last row. @throws IoError
  void commit();

 private:
  std::int64_t count_ = 0, n_written_ = 0;
  int sh_degree_ = 0;
  AtomicFile file_;
};

/// Reads by property name, in any order and of any scalar type, binary (both byte orders) or ASCII. The SH degree
/// follows from the number of f_rest properties; normals are not read. @throws InputError, also for values that are not
/// finite and quaternions of length 0
SplatCloud read_splat_ply(const std::filesystem::path& path);
SplatCloud read_splat_ply(FileReader& file);

/// Whether the file holds Gaussians rather than plain points, by its header. @throws InputError if it is no PLY
bool is_splat_ply(const std::filesystem::path& path);

/// x y z as float, red green blue as uchar.
void write_point_ply(const std::filesystem::path& path, const PointCloud& points);

/// As read_splat_ply. Colours of a real type count from 0 to 1, 16-bit ones are reduced; points without are mid-grey.
PointCloud read_point_ply(const std::filesystem::path& path);
PointCloud read_point_ply(FileReader& file);

}  // namespace b3dgs
