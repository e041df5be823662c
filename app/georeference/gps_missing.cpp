// Replaces gps.cpp if libexiv2 or GeographicLib was not found, and in the engine, which runs no command that needs
// them.
#include "app/georeference/gps.h"

namespace b3dgs {

bool can_read_gps() {
  return false;
}

std::optional<GpsPosition> read_gps(const std::filesystem::path&) {
  return std::nullopt;
}

std::array<double, 3> east_north_up(const GpsPosition&, const GpsPosition&) {
  return {};
}

UtmPlace utm_place(const GpsPosition&) {
  return {};
}

}  // namespace b3dgs
