#include "reconstruct/video_frames.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdlib>
#include <opencv2/imgproc.hpp>
#include <utility>

#include "core/check.h"
#include "core/files/atomic_file.h"
#include "core/json_text.h"
#include "core/print.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

constexpr double kFramesPerSecond = 2;
constexpr std::size_t kLeastFrames = 100, kMostFrames = 300;
// The system limits a word of a command line to 128 KiB; a frame takes up to 20 bytes of it.
constexpr std::size_t kFramesOfACall = 5000;

/// A value that ffprobe writes as text, such as "10/1" or "5.000000"; 0 if it is missing or unknown ("N/A").
double number_of(const Json& json, const char* key) {
  if (!json.is_object() || !json.contains(key) || !json[key].is_string()) return 0;
  const std::string text = json[key].get<std::string>();
  char* end = nullptr;
  double value = std::strtod(text.c_str(), &end);
  if (*end == '/') value /= std::strtod(end + 1, nullptr);
  return std::isfinite(value) && value > 0 ? value : 0;
}

/// A path is read as such, also if it begins with '-' or has a colon.
std::string file_argument(const fs::path& path) {
  return "file:" + fs::absolute(path).string();
}

/// Each decoded frame once, whatever the times in the file: some muxers would otherwise repeat or drop frames.
constexpr const char* kEachFrame = "settb=1/25,setpts=N";

std::vector<std::string> ffmpeg_command(const fs::path& video, const std::string& filter) {
  return {"ffmpeg", "-nostdin", "-hide_banner", "-v",  "error", "-i", file_argument(video),
          "-map",   "0:v:0",    "-an",          "-vf", filter,  "-r", "25"};
}

std::vector<double> measure_sharpness(const fs::path& video, std::size_t expected, ProgramLog& log,
                                      const std::function<void(std::size_t done, std::size_t total)>& progress) {
  std::vector<double> values;
  PgmStream images([&](const std::uint8_t* grey, int width, int height) {
    values.push_back(sharpness(grey, width, height));
    progress(values.size(), std::max(expected, values.size()));
  });
  // At full size, noise counts more than edges.
  std::vector<std::string> command =
      ffmpeg_command(video, std::string(kEachFrame) + ",scale='min(960,iw)':-2:flags=area,format=gray");
  for (const char* word : {"-f", "image2pipe", "-c:v", "pgm", "-"}) command.emplace_back(word);
  log.run_for_bytes(command, [&](const char* data, std::size_t bytes) { images.add(data, bytes); });
  return values;
}

/// "(eq(n,1)+(eq(n,5)+eq(n,9)))", which selects the frames from `first` up to `last`. A tree: ffmpeg refuses
/// expressions that are more than 100 levels deep, and a sum of n terms in a row has n levels.
std::string selection(const std::size_t* first, const std::size_t* last) {
  if (last - first == 1) return detail::concat("eq(n,", *first, ")");
  const std::size_t* const middle = first + (last - first) / 2;
  return "(" + selection(first, middle) + "+" + selection(middle, last) + ")";
}

/// A pattern for image2, in which % begins a number.
std::string frame_pattern(const fs::path& folder) {
  std::string pattern;
  for (const char c : folder.string()) pattern += c == '%' ? "%%" : std::string(1, c);
  return "file:" + pattern + "/frame_%05d.jpg";
}

}  // namespace

PgmStream::PgmStream(std::function<void(const std::uint8_t* grey, int width, int height)> on_image)
    : on_image_(std::move(on_image)) {}

void PgmStream::add(const char* data, std::size_t bytes) {
  buffer_.insert(buffer_.end(), data, data + bytes);
  while (take_image()) {
  }
  if (begin_ > 0) buffer_.erase(buffer_.begin(), buffer_.begin() + static_cast<std::ptrdiff_t>(begin_));
  begin_ = 0;
}

bool PgmStream::take_image() {
  // "P5\n960 540\n255\n"
  constexpr std::size_t kLongestHeader = 40;
  constexpr int kMostPixels = 1 << 16;
  const char* const first = buffer_.data() + begin_;
  const char* const last = buffer_.data() + buffer_.size();
  const char* const newest = std::min(last, first + kLongestHeader);
  const char* at = first;
  int n_lines = 0, numbers[3]{}, n_numbers = 0;
  while (at < newest && n_lines < 3) n_lines += *at++ == '\n' ? 1 : 0;
  if (n_lines < 3 && newest == last) return false;  // the header is not complete
  bool is_header = n_lines == 3 && first[0] == 'P' && first[1] == '5';
  for (const char* digit = first + 2; is_header && digit < at && n_numbers < 3;) {
    const auto [end, error] = std::from_chars(digit, at, numbers[n_numbers]);
    n_numbers += error == std::errc() ? 1 : 0;
    digit = error == std::errc() ? end : digit + 1;
  }
  const auto [width, height, most] = std::tuple(numbers[0], numbers[1], numbers[2]);
  is_header = is_header && n_numbers == 3 && width > 0 && height > 0 && width <= kMostPixels && height <= kMostPixels &&
              most == 255;
  if (!is_header) input_error("ffmpeg wrote something else than the expected images (PGM of 8 bits)");
  const std::size_t n_pixels = static_cast<std::size_t>(width) * static_cast<std::size_t>(height);
  if (static_cast<std::size_t>(last - at) < n_pixels) return false;
  on_image_(reinterpret_cast<const std::uint8_t*>(at), width, height);
  begin_ += static_cast<std::size_t>(at - first) + n_pixels;
  return begin_ < buffer_.size();
}

void check_ffmpeg_is_installed() {
  for (const char* program : {"ffprobe", "ffmpeg"}) {
    if (find_program(program).empty()) {
      input_error(program, " was not found in PATH, which reads videos; install it: apt install ffmpeg");
    }
  }
}

VideoInfo read_video_info(const fs::path& video, ProgramLog& log) {
  check_ffmpeg_is_installed();
  std::string text;
  const std::string fault = detail::concat(video.string(), ": not a video that ffmpeg can read");
  try {
    log.run({"ffprobe", "-v", "error", "-select_streams", "v:0", "-show_entries",
             "stream=avg_frame_rate,nb_frames,duration:format=duration", "-of", "json", file_argument(video)},
            [&](const std::string& line) { text += line + "\n"; });
  } catch (const InputError& error) {
    input_error(fault, "; ", error.what());
  }
  // Warnings about the file may come before and after.
  const std::size_t begin = text.find('{'), end = text.rfind('}');
  const Json json = begin < end && end != std::string::npos ? parse_json(text.substr(begin, end - begin + 1)) : Json();
  if (!json.is_object() || !json.contains("streams") || !json["streams"].is_array() || json["streams"].empty()) {
    input_error(fault, " (it has no video stream)");
  }
  const Json& stream = json["streams"][0];
  VideoInfo info;
  info.seconds = number_of(stream, "duration");
  if (info.seconds == 0 && json.contains("format")) info.seconds = number_of(json["format"], "duration");
  double n_frames = number_of(stream, "nb_frames");
  if (n_frames == 0) n_frames = info.seconds * number_of(stream, "avg_frame_rate");
  info.n_frames = static_cast<std::size_t>(std::min(n_frames, 1e9));
  return info;
}

double sharpness(const std::uint8_t* grey, int width, int height) {
  const cv::Mat image(height, width, CV_8U, const_cast<std::uint8_t*>(grey));
  cv::Mat laplacian;
  cv::Laplacian(image, laplacian, CV_32F);
  cv::Scalar mean, deviation;
  cv::meanStdDev(laplacian, mean, deviation);
  return deviation[0] * deviation[0];
}

std::size_t automatic_frame_count(double seconds, std::size_t n_frames) {
  const double wanted = std::clamp<double>(kFramesPerSecond * seconds, kLeastFrames, kMostFrames);
  return std::min(n_frames, static_cast<std::size_t>(std::lround(wanted)));
}

std::vector<std::size_t> sharpest_of_windows(const std::vector<double>& sharpness, std::size_t count) {
  count = std::min(count, sharpness.size());
  std::vector<std::size_t> chosen;
  for (std::size_t window = 0; window < count; ++window) {
    const auto first = sharpness.begin() + static_cast<std::ptrdiff_t>(window * sharpness.size() / count);
    const auto end = sharpness.begin() + static_cast<std::ptrdiff_t>((window + 1) * sharpness.size() / count);
    chosen.push_back(static_cast<std::size_t>(std::max_element(first, end) - sharpness.begin()));
  }
  return chosen;
}

std::vector<std::string> extract_frames(
    const fs::path& video, std::size_t wanted, const fs::path& folder, ProgramLog& log,
    const std::function<void(const char* stage, std::size_t done, std::size_t total)>& progress) {
  const VideoInfo info = read_video_info(video, log);
  const std::vector<double> values =
      measure_sharpness(video, info.n_frames, log,
                        [&](std::size_t done, std::size_t total) { progress("measuring frames", done, total); });
  if (values.empty()) input_error(video.string(), ": the video has no frames that can be decoded");
  const double seconds = info.seconds > 0 ? info.seconds : static_cast<double>(values.size()) / 30;
  const std::vector<std::size_t> chosen =
      sharpest_of_windows(values, wanted > 0 ? wanted : automatic_frame_count(seconds, values.size()));

  if (chosen.size() < 2) {
    input_error(video.string(), ": only one frame (expected a video of which at least 2 frames can be used)");
  }

  create_folder(folder);
  for (std::size_t begin = 0; begin < chosen.size(); begin += kFramesOfACall) {
    const std::size_t count = std::min(chosen.size() - begin, kFramesOfACall);
    const std::size_t* const first = chosen.data() + begin;
    std::vector<std::string> command =
        ffmpeg_command(video, "select='" + selection(first, first + count) + "'," + kEachFrame);
    // After its last frame, ffmpeg need not decode the rest.
    for (const std::string& word :
         {std::string("-frames:v"), std::to_string(count), std::string("-f"), std::string("image2"),
          std::string("-start_number"), std::to_string(begin + 1), std::string("-q:v"), std::string("1"),
          std::string("-qmin"), std::string("1"), frame_pattern(fs::absolute(folder))}) {
      command.push_back(word);
    }
    progress("writing frames", begin, chosen.size());
    log.run(command);
  }
  std::vector<std::string> names;
  for (std::size_t i = 0; i < chosen.size(); ++i) {
    names.push_back(print_to_string("frame_%05zu.jpg", i + 1));
    if (!fs::exists(folder / names.back())) {
      input_error(video.string(), ": ffmpeg wrote ", i, " of ", chosen.size(), " frames");
    }
  }
  return names;
}

}  // namespace b3dgs
