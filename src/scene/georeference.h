// The place of a scene on the Earth: georeference.json in the scene folder, and a copy of it in the model folder. The
// coordinates of such a scene are metres east, north and up from an origin.
#pragma once

#include <array>
#include <filesystem>
#include <optional>
#include <string>

namespace b3dgs {

struct Georeference {
  static constexpr const char* kFile = "georeference.json";
  static constexpr std::array<double, 3> kUp{0, 0, 1};

  double latitude = 0, longitude = 0;  // of the origin, degrees, WGS 84
  std::optional<double> height;        // of the origin, m, as photographs count it; nothing if they have none
  int epsg = 0;                        // of the UTM zone
  double easting = 0, northing = 0;    // of the origin, m
  double convergence = 0;              // degrees, bearing of grid north at the origin
  double grid_scale = 1;               // metres on the grid per metre, at the origin
  int n_photographs = 0, n_fixes = 0;  // in the model, and those of them with a GPS position
  int n_kept = 0;                      // GPS positions that agree with the cameras
  double median_residual = 0, largest_residual = 0;  // m, distance between a kept position and its camera

  /// Returns easting, northing and height of a point of the scene. Within 1 km of the origin, the error is below 2 cm.
  std::array<double, 3> to_utm(const std::array<double, 3>& point) const;

  /// Returns "46.84271 N, 92.01573 W, height 180.2 m, EPSG:32615".
  std::string describe_origin() const;
  /// Returns "17 of 18 GPS positions agree, median 0.21 m, largest 0.38 m".
  std::string describe_fit() const;
};

/// Returns nothing if the folder has no georeference.json. @throws InputError if it is damaged
std::optional<Georeference> read_georeference(const std::filesystem::path& folder);

/// Writes the file. @throws IoError
void write_georeference(const std::filesystem::path& folder, const Georeference& georeference);

}  // namespace b3dgs
