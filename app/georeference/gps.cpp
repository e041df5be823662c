#include "app/georeference/gps.h"

#include <GeographicLib/LocalCartesian.hpp>
#include <GeographicLib/UTMUPS.hpp>
#include <cmath>
#include <exiv2/exiv2.hpp>
#include <string>

namespace b3dgs {
namespace {

/// Returns NaN if there is no such number.
double number_of(const Exiv2::ExifData& exif, const std::string& name, long index = 0) {
  const auto found = exif.findKey(Exiv2::ExifKey("Exif.GPSInfo.GPS" + name));
  if (found == exif.end() || found->count() <= index) return std::nan("");
  const auto [numerator, denominator] = found->toRational(index);
  return static_cast<double>(numerator) / denominator;  // 0 / 0: unknown
}

/// Returns the sign that a reference such as N or S gives to a number.
double sign_of(const Exiv2::ExifData& exif, const std::string& name, const std::string& negative) {
  const auto found = exif.findKey(Exiv2::ExifKey("Exif.GPSInfo.GPS" + name + "Ref"));
  return found != exif.end() && found->toString().rfind(negative, 0) == 0 ? -1 : 1;
}

double degrees_of(const Exiv2::ExifData& exif, const std::string& name, const std::string& negative) {
  double degrees = number_of(exif, name), unit = 1;
  for (const long part : {1, 2}) {  // minutes and seconds, which may be missing
    const double value = number_of(exif, name, part);
    unit /= 60;
    if (std::isfinite(value)) degrees += unit * value;
  }
  return sign_of(exif, name, negative) * degrees;
}

}  // namespace

bool can_read_gps() {
  return true;
}

std::optional<GpsPosition> read_gps(const std::filesystem::path& photograph) {
  Exiv2::LogMsg::setLevel(Exiv2::LogMsg::mute);
  GpsPosition position;
  try {
    const auto image = Exiv2::ImageFactory::open(photograph.string());
    image->readMetadata();
    const Exiv2::ExifData& exif = image->exifData();
    position.latitude = degrees_of(exif, "Latitude", "S");
    position.longitude = degrees_of(exif, "Longitude", "W");
    const double height = number_of(exif, "Altitude");
    if (std::isfinite(height)) position.height = sign_of(exif, "Altitude", "1") * height;
  } catch (const std::exception&) {  // the file has no EXIF data that can be read
    return std::nullopt;
  }
  const bool is_valid = std::abs(position.latitude) <= 90 && std::abs(position.longitude) <= 180;
  const bool is_filler = position.latitude == 0 && position.longitude == 0;  // of cameras without reception
  return is_valid && !is_filler ? std::optional(position) : std::nullopt;
}

std::array<double, 3> east_north_up(const GpsPosition& origin, const GpsPosition& position) {
  const double height = origin.height.value_or(0);
  std::array<double, 3> local{};
  GeographicLib::LocalCartesian(origin.latitude, origin.longitude, height)
      .Forward(position.latitude, position.longitude, position.height.value_or(height), local[0], local[1], local[2]);
  return local;
}

UtmPlace utm_place(const GpsPosition& position) {
  constexpr int kNorthernZone = 32600, kSouthernZone = 32700, kPolarZone = 61;
  UtmPlace place;
  int zone = 0;
  bool is_north = true;
  double ignored = 0;
  GeographicLib::UTMUPS::Forward(position.latitude, position.longitude, zone, is_north, place.easting, place.northing,
                                 place.convergence, place.grid_scale);
  place.epsg = (is_north ? kNorthernZone : kSouthernZone) + (zone == GeographicLib::UTMUPS::UPS ? kPolarZone : zone);
  // The grid is at sea level, where distances are shorter.
  constexpr double kStep = 100;  // m
  double latitude = 0, longitude = 0, easting = 0, northing = 0;
  GeographicLib::LocalCartesian(position.latitude, position.longitude, position.height.value_or(0))
      .Reverse(0, kStep, 0, latitude, longitude, ignored);
  GeographicLib::UTMUPS::Forward(latitude, longitude, zone, is_north, easting, northing, ignored, ignored, zone);
  place.grid_scale = std::hypot(easting - place.easting, northing - place.northing) / kStep;
  return place;
}

}  // namespace b3dgs
