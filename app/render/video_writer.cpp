#include "app/render/video_writer.h"

#include <iterator>
#include <sstream>
#include <system_error>
#include <vector>

#include "core/check.h"
#include "core/text.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using Words = std::vector<std::string>;

std::string extension_of(const fs::path& path) {
  return lower_case(path.extension().string());
}

/// Returns the words separated by blanks.
Words words_of(const std::string& text) {
  std::istringstream stream(text);
  return {std::istream_iterator<std::string>(stream), {}};
}

/// Returns ffmpeg's options for the output, without the file's name.
Words output_options(const std::string& extension, int crf) {
  if (extension == ".gif") {
    return words_of("-vf split[frames][all];[all]palettegen[palette];[frames][palette]paletteuse -loop 0 -f gif");
  }
  const bool is_mp4 = extension == ".mp4";
  if (crf < 0) crf = is_mp4 ? 18 : 30;
  // Without these tags, players assume BT.709 for videos of HD size, but ffmpeg converts to BT.601. The transfer
  // function is that of the images, sRGB.
  return words_of(detail::concat(
      "-vf crop=trunc(iw/2)*2:trunc(ih/2)*2:0:0,scale=out_color_matrix=bt709:out_range=tv,format=yuv420p"
      " -colorspace bt709 -color_primaries bt709 -color_trc iec61966-2-1 -color_range tv -crf ",
      crf, is_mp4 ? " -c:v libx264 -movflags +faststart -f mp4" : " -c:v libvpx-vp9 -b:v 0 -row-mt 1 -f webm"));
}

}  // namespace

void check_video_file(const fs::path& path, bool may_replace) {
  const std::string extension = extension_of(path);
  if (extension != ".mp4" && extension != ".webm" && extension != ".gif") {
    input_error(path.string(), ": expected a video file that ends in .mp4, .webm or .gif");
  }
  if (find_program("ffmpeg").empty()) {
    input_error("--video needs the program ffmpeg, which is not in PATH; install it: apt-get install ffmpeg");
  }
  std::error_code error;
  if (fs::exists(path, error) && !(may_replace && fs::is_regular_file(path, error))) {
    input_error(path.string(), " exists; choose another name",
                fs::is_regular_file(path, error) ? ", or replace it with --overwrite" : "");
  }
}

VideoWriter::VideoWriter(const fs::path& path, ImageSize size, int channels, double fps, int crf)
    : path_(path), size_(size), channels_(channels), file_(path) {
  B3DGS_CHECK(channels == 1 || channels == 3, channels, " channels");
  if (size.width < 2 || size.height < 2) {
    input_error(path.string(), ": expected frames of at least 2 x 2 px, found ", size.width, " x ", size.height);
  }
  check_video_file(path, /*may_replace=*/true);
  Words words = words_of(detail::concat("ffmpeg -hide_banner -loglevel error -y -f rawvideo -pixel_format ",
                                        channels == 3 ? "rgb24" : "gray", " -video_size ", size.width, "x", size.height,
                                        print_to_string(" -framerate %.6g -i pipe:0", fps)));
  const Words output = output_options(extension_of(path), crf);
  words.insert(words.end(), output.begin(), output.end());
  words.push_back("file:" + file_.temporary().string());
  ffmpeg_ = std::make_unique<Child>(words, [this](const std::string& line) {
    if (!line.empty()) last_line_ = line;
  });
}

void VideoWriter::write(const Image8& frame) {
  B3DGS_CHECK(frame.width == size_.width && frame.height == size_.height && frame.channels == channels_, "a frame of ",
              frame.width, " x ", frame.height, " x ", frame.channels);
  if (!ffmpeg_->write(frame.pixels.data(), frame.pixels.size())) fail(ffmpeg_->finish());
}

void VideoWriter::finish() {
  const ChildResult result = ffmpeg_->finish();
  // With a full disk, ffmpeg 5 reports an error and exits with 0.
  if (!result.succeeded() || !last_line_.empty()) fail(result);
  file_.commit();
}

void VideoWriter::fail(const ChildResult& result) {
  io_error(path_.string(), ": ffmpeg failed (", describe(result), ")", last_line_.empty() ? "" : ": " + last_line_);
}

}  // namespace b3dgs
