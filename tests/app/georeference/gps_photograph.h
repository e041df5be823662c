// JPEG files with a GPS position, as cameras write them.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <opencv2/imgcodecs.hpp>
#include <optional>
#include <string>
#include <vector>

#include "support/files.h"

namespace b3dgs::test {

struct GpsTag {
  double latitude = 0, longitude = 0;  // degrees
  std::optional<double> height;        // m
};

/// Writes a small JPEG whose EXIF data have the position: degrees, minutes and seconds in steps of 1e-5 seconds, which
/// are 0.3 mm, and millimetres.
inline void write_gps_photograph(const std::filesystem::path& file, const std::optional<GpsTag>& tag) {
  const auto number = [](std::uint32_t value, int bytes) {
    std::string text;
    for (int i = 0; i < bytes; ++i) text += static_cast<char>(value >> (8 * i) & 0xff);
    return text;
  };
  const auto rational = [&](double value, std::uint32_t denominator) {
    return number(static_cast<std::uint32_t>(std::llround(value * denominator)), 4) + number(denominator, 4);
  };
  const auto degrees = [&](double value) {
    const double whole = std::floor(value), minutes = std::floor(60 * (value - whole));
    return rational(whole, 1) + rational(minutes, 1) + rational(3600 * (value - whole) - 60 * minutes, 100000);
  };
  std::vector<std::uint8_t> jpeg;
  cv::imencode(".jpg", cv::Mat(6, 8, CV_8UC3, cv::Scalar(90, 120, 60)), jpeg);
  std::string exif;
  if (tag) {
    // One entry at byte 8, which leads to the GPS entries at byte 26. Their long values follow.
    const int n = tag->height ? 6 : 4;
    const auto values = static_cast<std::uint32_t>(26 + 2 + 12 * n + 4);
    const auto entry = [&](std::uint32_t id, std::uint32_t type, std::uint32_t count, const std::string& value) {
      return number(id, 2) + number(type, 2) + number(count, 4) + value;
    };
    const auto letter = [](char text) { return std::string{text, '\0', '\0', '\0'}; };
    exif = "II" + number(42, 2) + number(8, 4) + number(1, 2) + entry(0x8825, 4, 1, number(26, 4)) + number(0, 4);
    exif += number(static_cast<std::uint32_t>(n), 2) + entry(1, 2, 2, letter(tag->latitude < 0 ? 'S' : 'N')) +
            entry(2, 5, 3, number(values, 4)) + entry(3, 2, 2, letter(tag->longitude < 0 ? 'W' : 'E')) +
            entry(4, 5, 3, number(values + 24, 4));
    if (tag->height) {
      exif += entry(5, 1, 1, letter(*tag->height < 0 ? '\1' : '\0')) + entry(6, 5, 1, number(values + 48, 4));
    }
    exif += number(0, 4) + degrees(std::abs(tag->latitude)) + degrees(std::abs(tag->longitude));
    if (tag->height) exif += rational(std::abs(*tag->height), 1000);
    exif = std::string("Exif\0\0", 6) + exif;
    const std::size_t length = exif.size() + 2;
    exif = std::string{'\xff', '\xe1', static_cast<char>(length >> 8), static_cast<char>(length & 0xff)} + exif;
  }
  std::string bytes(jpeg.begin(), jpeg.begin() + 2);
  bytes += exif;
  bytes.append(jpeg.begin() + 2, jpeg.end());
  write_bytes(file, bytes);
}

/// Returns the position of a point that is x, y, z m east, north and up of the origin, by way of coordinates from the
/// centre of the Earth (WGS 84).
inline GpsTag position_of(const GpsTag& origin, const std::array<double, 3>& local) {
  constexpr double kA = 6378137, kF = 1 / 298.257223563, kE2 = kF * (2 - kF), kDegrees = 180 / 3.14159265358979323846;
  const double latitude = origin.latitude / kDegrees, longitude = origin.longitude / kDegrees;
  const double sp = std::sin(latitude), cp = std::cos(latitude), sl = std::sin(longitude), cl = std::cos(longitude);
  const double n = kA / std::sqrt(1 - kE2 * sp * sp), h = origin.height.value_or(0);
  const auto [e, u, v] = local;  // east, north, up
  const double x = (n + h) * cp * cl - sl * e - sp * cl * u + cp * cl * v;
  const double y = (n + h) * cp * sl + cl * e - sp * sl * u + cp * sl * v;
  const double z = (n * (1 - kE2) + h) * sp + cp * u + sp * v;
  const double p = std::hypot(x, y);
  double at = std::atan2(z, p), height = 0;
  for (int i = 0; i < 10; ++i) {
    const double radius = kA / std::sqrt(1 - kE2 * std::sin(at) * std::sin(at));
    height = p / std::cos(at) - radius;
    at = std::atan2(z, p * (1 - kE2 * radius / (radius + height)));
  }
  return {at * kDegrees, std::atan2(y, x) * kDegrees, height};
}

}  // namespace b3dgs::test
