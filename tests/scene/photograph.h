// JPEG files as cameras write them.
#pragma once

#include <cstddef>
#include <cstdint>
#include <opencv2/imgcodecs.hpp>
#include <string>
#include <vector>

namespace b3dgs::test {

/// Returns a smooth image with a bright corner, with a colour profile and EXIF data with the orientation and a camera's
/// name.
inline std::vector<std::uint8_t> jpeg_with_orientation(int width, int height, int orientation, bool is_little_endian) {
  cv::Mat image(height, width, CV_8UC3);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      image.at<cv::Vec3b>(y, x) =
          cv::Vec3b(static_cast<std::uint8_t>(200 * x / width), 60, static_cast<std::uint8_t>(200 * y / height));
    }
  }
  image(cv::Rect(0, 0, width / 3, height / 4)).setTo(cv::Scalar(250, 250, 250));
  std::vector<std::uint8_t> encoded;
  cv::imencode(".jpg", image, encoded, {cv::IMWRITE_JPEG_QUALITY, 98});

  const auto number = [&](std::uint32_t value, int bytes) {
    std::string text;
    for (int i = 0; i < bytes; ++i) {
      const int shift = 8 * (is_little_endian ? i : bytes - 1 - i);
      text += static_cast<char>(value >> shift & 0xff);
    }
    return text;
  };
  const std::string name("TestCam\0", 8);
  const std::string tiff = std::string(is_little_endian ? "II" : "MM") + number(42, 2) + number(8, 4) + number(2, 2) +
                           number(0x0110, 2) + number(2, 2) + number(8, 4) + number(38, 4) +  // model, at byte 38
                           number(0x0112, 2) + number(3, 2) + number(1, 4) +
                           number(static_cast<std::uint32_t>(orientation), 2) + number(0, 2) + number(0, 4) + name;
  const auto segment = [](char marker, const std::string& content) {
    const std::size_t length = content.size() + 2;
    return std::string{'\xff', marker, static_cast<char>(length >> 8), static_cast<char>(length & 0xff)} + content;
  };
  const std::string segments = segment('\xe1', std::string("Exif\0\0", 6) + tiff) +
                               segment('\xe2', std::string("ICC_PROFILE\0\1\1", 14) + "profile");
  std::vector<std::uint8_t> jpeg(encoded.begin(), encoded.begin() + 2);
  jpeg.insert(jpeg.end(), segments.begin(), segments.end());
  jpeg.insert(jpeg.end(), encoded.begin() + 2, encoded.end());
  return jpeg;
}

}  // namespace b3dgs::test
