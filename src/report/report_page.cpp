#include "report/page_data.h"

#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "core/check.h"
#include "core/text.h"

namespace b3dgs {

/// Of page/, which CMake makes one string of. "@DATA@" stands where the data goes, as JSON.
extern const char* const kReportPage;

namespace {

using Json = nlohmann::ordered_json;

void round_numbers(Json& json) {
  if (json.is_number_float()) {
    const auto value = json.get<double>();
    const char* const format = std::fabs(value) < 1e5 ? "%.6g" : "%.9g";  // means of counts stay exact
    json = std::strtod(print_to_string(format, value).c_str(), nullptr);
  }
  if (!json.is_structured()) return;
  for (Json& part : json) round_numbers(part);
}

std::string base64(const std::vector<std::uint8_t>& bytes) {
  constexpr char kDigits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string text;
  for (std::size_t i = 0; i < bytes.size(); i += 3) {
    const std::size_t left = bytes.size() - i;
    const std::uint32_t b = left > 1 ? bytes[i + 1] : 0, c = left > 2 ? bytes[i + 2] : 0;
    const std::uint32_t triple = std::uint32_t{bytes[i]} << 16 | b << 8 | c;
    text += kDigits[triple >> 18];
    text += kDigits[triple >> 12 & 63];
    text += left > 1 ? kDigits[triple >> 6 & 63] : '=';
    text += left > 2 ? kDigits[triple & 63] : '=';
  }
  return text;
}

}  // namespace

std::string report_page(Json data) {
  round_numbers(data);
  // ASCII only, and "<" occurs in strings alone: no text can end the script element or open a comment.
  const std::string json = data.dump(-1, ' ', /*ensure_ascii=*/true, Json::error_handler_t::replace);
  std::string page = kReportPage;
  const std::string mark = "@DATA@";
  std::string text;
  text.reserve(json.size());
  for (const char c : json) c == '<' ? text += "\\u003c" : text += c;
  return page.replace(page.find(mark), mark.size(), text);
}

std::string data_uri(const Image8& rgb) {
  constexpr int kQuality = 82;
  const cv::Mat from(rgb.height, rgb.width, CV_8UC3, const_cast<std::uint8_t*>(rgb.pixels.data()));
  cv::Mat bgr;
  cv::cvtColor(from, bgr, cv::COLOR_RGB2BGR);
  std::vector<std::uint8_t> bytes;
  if (!cv::imencode(".jpg", bgr, bytes, {cv::IMWRITE_JPEG_QUALITY, kQuality})) {
    io_error("cannot encode an image of ", rgb.width, " x ", rgb.height, " px as JPEG for report.html");
  }
  return "data:image/jpeg;base64," + base64(bytes);
}

}  // namespace b3dgs
