// Videos for `b3dgs render --video`. Frames are written to the standard input of ffmpeg as they are rendered.
#pragma once

#include <filesystem>
#include <memory>
#include <string>

#include "core/files/atomic_file.h"
#include "core/process/child_process.h"
#include "scene/images/image.h"

namespace b3dgs {

/// @throws InputError unless the name ends in .mp4, .webm or .gif and ffmpeg is installed, or if the file exists and
/// must not be replaced
void check_video_file(const std::filesystem::path& path, bool may_replace);

/// Writes the file atomically, also if a signal ends the program.
class VideoWriter {
 public:
  /// Starts ffmpeg: H.264 in .mp4, VP9 in .webm, both with 4:2:0 chroma and BT.709, or .gif. Sizes are made even by
  /// removing the last row or column. `channels`: 3 (RGB) or 1 (grey). `crf`: quality, lower is better; -1: 18 for
  /// H.264, 30 for VP9. @throws InputError as check_video_file(); IoError
  VideoWriter(const std::filesystem::path& path, ImageSize size, int channels, double fps, int crf);

  /// Appends a frame of the size and channels above. @throws IoError with ffmpeg's last line
  void write(const Image8& frame);

  /// @throws IoError with ffmpeg's last line
  void finish();

 private:
  [[noreturn]] void fail(const ChildResult& result);

  std::filesystem::path path_;
  ImageSize size_;
  int channels_;
  std::string last_line_;  // last line of ffmpeg
  // A signal that ends this program is raised again when the last EndingSignals is destroyed, after the temporary file.
  EndingSignals signals_;
  AtomicFile file_;
  std::unique_ptr<Child> ffmpeg_;
};

}  // namespace b3dgs
