// SPZ, Niantic's compressed format of Gaussians (https://github.com/nianticlabs/spz). Versions 1 to 3 are a gzip stream
// of a header of 16 bytes and six arrays, little-endian:
//
//   uint32 magic ("NGSP"), version, count; uint8 SH degree (0-3), fractional bits, flags (1: anti-aliased), 0
//   positions   3 x 24-bit fixed point with the header's fractional bits; version 1: 3 x 16-bit floating point
//   opacities   uint8, 0 to 1
//   colours     3 x uint8, SH coefficient of degree 0: (byte / 255 - 0.5) / 0.15
//   log scales  3 x uint8: byte / 16 - 10
//   rotations   version 3: uint32, from the top 2 bits for the index of the largest component in x, y, z, w, which is
//               positive, and 10 bits for each of the others in this order: sign, magnitude / 511 * sqrt(1/2).
//               Before: x, y, z as uint8: byte / 127.5 - 1, and w positive
//   SH          uint8 for each coefficient of degree 1 and higher, RGB: (byte - 128) / 128
//
// Axes are right, up, back; those of a PLY are right, down, front. Both functions convert: y and z change sign, and so
// do the SH coefficients that are odd in them.
#pragma once

#include <filesystem>

#include "core/files/file_reader.h"
#include "model/formats/splat_cloud.h"

namespace b3dgs {

/// Fractional bits with which write_spz() stores positions: 12, a step of 1/4096 of a world unit; more if Gaussians are
/// so small that the step would be more than an eighth of their median scale, fewer if the largest coordinate does not
/// fit into 24 bits. @throws InputError if it does not fit without fraction, either
int spz_fractional_bits(const SplatCloud& cloud);

/// What write_spz() keeps of an SH coefficient unless asked for less: all that the format holds.
inline constexpr int kSpzShBits = 8;

/// Writes version 3. SH coefficients are stored from -1 to 1 with `sh_bits` bits (1 to 8), so in steps of 1/128 with 8
/// and of 1/8 with 4; fewer bits compress better. Log scales are clamped to -10 to 5.94. The file appears complete or
/// not at all. @throws IoError; InputError as spz_fractional_bits()
void write_spz(const std::filesystem::path& path, const SplatCloud& cloud, int sh_bits = kSpzShBits);

/// Reads versions 1 to 3. Opacities of 0 and 1 become the finite values 0.001 and 0.999.
/// @throws InputError, also for a file that claims to decompress to more than a hundred times its size
SplatCloud read_spz(const std::filesystem::path& path);
SplatCloud read_spz(FileReader& file);

}  // namespace b3dgs
