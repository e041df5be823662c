// GPS positions in the EXIF data of photographs, and coordinates on the Earth. With libexiv2 and GeographicLib, or
// without (gps_missing.cpp).
#pragma once

#include <array>
#include <filesystem>
#include <optional>

namespace b3dgs {

struct GpsPosition {
  double latitude = 0, longitude = 0;  // degrees, WGS 84
  std::optional<double> height;        // m, above sea level as most cameras count it
};

/// Returns whether the program was built with the libraries.
bool can_read_gps();

/// Returns nothing if the photograph has no usable position.
std::optional<GpsPosition> read_gps(const std::filesystem::path& photograph);

/// Returns metres east, north and up from the origin. A missing height counts as that of the origin.
std::array<double, 3> east_north_up(const GpsPosition& origin, const GpsPosition& position);

struct UtmPlace {
  int epsg = 0;                      // of the UTM zone; near the poles, of UPS
  double easting = 0, northing = 0;  // m
  double convergence = 0;            // degrees, bearing of grid north
  double grid_scale = 1;             // metres on the grid per metre at the height of the position
};

UtmPlace utm_place(const GpsPosition& position);

}  // namespace b3dgs
