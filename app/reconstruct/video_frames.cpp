#include "app/reconstruct/video_frames.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <opencv2/imgproc.hpp>
#include <utility>

#include "core/check.h"
#include "core/files/atomic_file.h"
#include "core/json_text.h"
#include "core/text.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

constexpr double kFramesPerSecond = 2;
constexpr std::size_t kLeastFrames = 100, kMostFrames = 300;
// The system limits a word of a command line to 128 KiB, and a frame takes up to 20 bytes of it.
constexpr std::size_t kFramesOfACall = 5000;

/// Returns a value that ffprobe writes as text, such as "10/1" or "5.000000"; 0 if it is missing or unknown ("N/A").
double number_of(const Json& json, const char* key) {
  if (!json.is_object() || !json.contains(key) || !json[key].is_string()) return 0;
  const std::string text = json[key].get<std::string>();
  char* end = nullptr;
  double value = std::strtod(text.c_str(), &end);
  if (*end == '/') value /= std::strtod(end + 1, nullptr);
  return std::isfinite(value) && value > 0 ? value : 0;
}

/// Returns a number of pixels; 0 if it is missing or impossible.
int side_of(const Json& json, const char* key) {
  constexpr int kMostPixels = 1 << 16;
  if (!json.is_object() || !json.contains(key) || !json[key].is_number_unsigned()) return 0;
  return json[key].get<std::uint64_t>() <= kMostPixels ? json[key].get<int>() : 0;
}

/// Makes ffmpeg read the argument as a path, also if it begins with '-' or has a colon.
std::string file_argument(const fs::path& path) {
  return "file:" + fs::absolute(path).string();
}

// Containers of videos. Playlists are excluded, because they would make ffmpeg read other files.
constexpr const char* kProtocols = "file,pipe";
constexpr const char* kContainers =
    "mov,mp4,matroska,webm,avi,mpeg,mpegts,mpegvideo,flv,asf,ogg,mxf,dv,gif,apng,h264,hevc,m4v,mjpeg,ivf,obu,rm,wtv,"
    "nut,"
    "yuv4mpegpipe";

/// Passes each decoded frame once, regardless of the times in the file. Otherwise some muxers would repeat or drop
/// frames.
constexpr const char* kEachFrame = "settb=1/25,setpts=N";

std::vector<std::string> ffmpeg_command(const fs::path& video, const std::string& filter) {
  return {"ffmpeg",
          "-nostdin",
          "-hide_banner",
          "-v",
          "error",
          "-protocol_whitelist",
          kProtocols,
          "-format_whitelist",
          kContainers,
          "-i",
          file_argument(video),
          "-map",
          "0:v:0",
          "-an",
          "-vf",
          filter,
          "-r",
          "25"};
}

std::vector<double> measure_sharpness(const fs::path& video, const VideoInfo& info, ProgramLog& log,
                                      const std::function<void(std::size_t done, std::size_t total)>& progress) {
  // At full size, noise outweighs edges.
  const int width = std::min(960, info.width), height = std::max(1, info.height * width / info.width);
  const std::string filter = detail::concat(kEachFrame, ",scale=", width, ":", height, ":flags=area,format=gray");
  std::vector<std::string> command = ffmpeg_command(video, filter);
  command.insert(command.begin() + 1, "-noautorotate");  // width and height are those of the file
  command.insert(command.end(), {"-f", "rawvideo", "-"});
  std::vector<double> values;
  std::vector<std::uint8_t> frame;
  const auto frame_bytes = static_cast<std::size_t>(width) * static_cast<std::size_t>(height);
  log.run(command, {}, [&](const char* data, std::size_t bytes) {
    for (const char* const end = data + bytes; data < end;) {
      const std::size_t part = std::min(static_cast<std::size_t>(end - data), frame_bytes - frame.size());
      frame.insert(frame.end(), data, data + part);
      data += part;
      if (frame.size() < frame_bytes) continue;
      values.push_back(sharpness(frame.data(), width, height));
      frame.clear();
      progress(values.size(), std::max(info.n_frames, values.size()));
    }
  });
  return values;
}

/// Returns "(eq(n,1)+(eq(n,5)+eq(n,9)))", which selects the frames from `first` up to `last`. It is a tree, because
/// ffmpeg rejects expressions more than 100 levels deep, and a plain sum of n terms has n levels.
std::string selection(const std::size_t* first, const std::size_t* last) {
  if (last - first == 1) return detail::concat("eq(n,", *first, ")");
  const std::size_t* const middle = first + (last - first) / 2;
  return "(" + selection(first, middle) + "+" + selection(middle, last) + ")";
}

/// Returns a pattern for image2, in which % begins a number.
std::string frame_pattern(const fs::path& folder) {
  std::string pattern;
  for (const char c : folder.string()) pattern += c == '%' ? "%%" : std::string(1, c);
  return "file:" + pattern + "/frame_%05d.jpg";
}

}  // namespace

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
    log.run(
        {"ffprobe", "-v", "error", "-protocol_whitelist", kProtocols, "-format_whitelist", kContainers,
         "-select_streams", "v:0", "-show_entries",
         "stream=width,height,avg_frame_rate,nb_frames,duration:format=duration", "-of", "json", file_argument(video)},
        [&](const std::string& line) { text += line + "\n"; });
  } catch (const InputError& error) {
    input_error(fault, "; ", error.what());
  }
  // There may be warnings about the file before and after.
  const std::size_t begin = text.find('{'), end = text.rfind('}');
  const Json json = begin < end && end != std::string::npos ? parse_json(text.substr(begin, end - begin + 1)) : Json();
  const Json stream = json.is_object() ? json.value(Json::json_pointer("/streams/0"), Json()) : Json();
  VideoInfo info;
  info.width = side_of(stream, "width");
  info.height = side_of(stream, "height");
  if (info.width == 0 || info.height == 0) input_error(fault, " (it has no video stream)");
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
  const std::vector<double> values = measure_sharpness(
      video, info, log, [&](std::size_t done, std::size_t total) { progress("measuring frames", done, total); });
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
    // ffmpeg need not decode frames after the last selected one.
    command.insert(command.end(),
                   {"-frames:v", std::to_string(count), "-f", "image2", "-start_number", std::to_string(begin + 1),
                    "-q:v", "1", "-qmin", "1", frame_pattern(fs::absolute(folder))});
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
